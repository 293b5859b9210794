"""The regression test of estimates against the truth."""

import pytest

import physid
from physid.criticism import checking
from physid.criticism.comparison import Result
from physid.errors import InputError


@pytest.fixture
def estimates(monkeypatch):
    """Replace the fit by given estimates; collect its options."""
    seen = []

    def install(**values):
        def fit(model, records, **options):
            seen.append(options)
            rows = [
                {"name": n.replace("__", "."), "value": v, "std_error": 0.1, "unit": "1"}
                for n, v in values.items()
            ]
            data = {"parameters": rows, "channels": [], "records": [], "notes": []}
            return Result(data=data | {"simulation": {}})

        monkeypatch.setattr(checking, "fit", fit)
        return seen

    return install


@pytest.mark.parametrize(("value", "holds"), [(0.0205, True), (0.0195, True), (0.0207, False)])
def test_tolerance_is_relative(two_inertia, estimates, value, holds):
    estimates(load__damping=value)
    result = physid.check(two_inertia, [], {"load.damping": 0.02}, within=0.03).as_dict()
    assert result["holds"] is holds
    [row] = result["parameters"]
    assert row["deviation"] == pytest.approx(value / 0.02 - 1.0)
    assert row["truth"] == 0.02


def test_of_a_truth_of_zero_the_tolerance_is_absolute(two_inertia, estimates):
    estimates(load__damping=0.02)
    assert physid.check(two_inertia, [], {"load.damping": 0.0}).as_dict()["holds"]


def test_one_that_deviates_is_enough(two_inertia, estimates):
    estimates(load__damping=0.02, drive__damping=0.5)
    truth = {"load.damping": 0.02, "drive.damping": 0.01}
    result = physid.check(two_inertia, [], truth).as_dict()
    assert not result["holds"]
    assert [p["holds"] for p in result["parameters"]] == [True, False]


def test_an_unknown_estimate_does_not_hold(two_inertia, estimates):
    estimates(load__damping=None)
    result = physid.check(two_inertia, [], {"load.damping": 0.02}).as_dict()
    assert result["parameters"][0]["deviation"] is None
    assert not result["holds"]


def test_the_parameters_of_the_truth_are_freed(two_inertia, estimates):
    seen = estimates(load__damping=0.02)
    physid.check(two_inertia, [], {"joint:load.damping": 0.02})
    assert seen[0]["fit"] == ["load.damping"]
    physid.check(two_inertia, [], {"load.damping": 0.02}, fit=("load.damping", "shaft.damping"))
    assert seen[1]["fit"] == ("load.damping", "shaft.damping")


def test_a_parameter_that_is_not_fitted(two_inertia, estimates):
    estimates(drive__damping=0.02)
    with pytest.raises(InputError, match=r"load\.damping.*not fitted.*drive\.damping"):
        physid.check(two_inertia, [], {"load.damping": 0.02}, fit=("drive.damping",))


@pytest.mark.parametrize("within", [0.0, -0.1, float("nan")])
def test_tolerance_must_be_positive(two_inertia, within):
    with pytest.raises(InputError, match="3%"):
        physid.check(two_inertia, [], {"load.damping": 0.02}, within=within)


@pytest.mark.parametrize(
    "text",
    [
        '"hinge.damping" = 2\n"arm.mass" = 1.5',
        "hinge.damping = 2\narm.mass = 1.5",
        "[hinge]\ndamping = 2\n[arm]\nmass = 1.5",
    ],
)
def test_toml_in_every_form(tmp_path, text):
    path = tmp_path / "truth.toml"
    path.write_text(text, encoding="utf-8")
    assert checking.read_truth(path) == {"hinge.damping": 2.0, "arm.mass": 1.5}


@pytest.mark.parametrize("text", ["a.b = true", 'a.b = "1"', "a.b = [1.0]"])
def test_toml_of_anything_but_numbers(tmp_path, text):
    path = tmp_path / "truth.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.b"):
        checking.read_truth(path)


def test_truth_that_names_nothing_in_the_model(two_inertia, tmp_path):
    path = tmp_path / "truth.toml"
    path.write_text('"lod.damping" = 1.0', encoding="utf-8")
    with pytest.raises(InputError, match=r"truth\.toml.*lod\.damping.*drive"):
        physid.check(two_inertia, [], path)


def test_whole_check_on_a_record(slider, make_run):
    result = physid.check(slider, [make_run()], {"rail.damping": 0.4, "rail.stiffness": 100.0})
    assert result.as_dict()["holds"], result.as_dict()["parameters"]
    wrong = physid.check(slider, [make_run()], {"rail.damping": 0.6})
    assert not wrong.as_dict()["holds"]
