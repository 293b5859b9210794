"""`--evidence`: files of strangers are refused in a sentence, and nothing is written."""

import json

import pytest

from tests.cli.conftest import OSCILLATOR, columns, write_csv

LEAD = {
    "effect": "stiffness_change",
    "location": "shaft",
    "parameters": [{"name": "factor", "value": 0.8}, {"name": "time", "value": 0.4}],
}


def monitored(*entries):
    return json.dumps({"schema": "physid.monitoring/1", "evidence": list(entries)}).encode()


@pytest.mark.parametrize("command", ["diagnose", "refine"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "given.json"),
        (b"", "given.json"),
        (b"{", "given.json"),
        (b"\xff\xfe\x00", "given.json"),
        (b"[" * 100_000, "given.json"),
        (b"[1, 2]", "given.json"),
        (b'{"schema": "physid.monitoring/1", "evidence": NaN}', "NaN"),
        (b'{"schema": "physid.check/1"}', "physid.check/1"),
        (b'{"schema": "physid.monitoring/1"}', "'evidence'"),
        (monitored({}), "'effect'"),
        (monitored(LEAD | {"location": "belt"}), "belt"),
        (monitored(LEAD | {"effect": "wear"}), "wear"),
        (monitored(LEAD | {"parameters": []}), "'factor'"),
        (
            monitored(LEAD | {"parameters": [{"name": "factor", "value": 1e999}]}),
            "given.json",
        ),
    ],
    ids=range(14),
)
def test_bad_evidence_is_refused(call, model, record, tmp_path, command, content, words):
    path, out = tmp_path / "given.json", tmp_path / "out"
    if content is not None:
        path.write_bytes(content)
    sentence = call(command, model, record, "--evidence", path, "--out", out).refused()
    assert words in sentence
    assert not out.exists()


def test_a_folder_without_a_result_is_refused(call, model, record, tmp_path):
    assert "result.json" in call("diagnose", model, record, "--evidence", tmp_path).refused()


def test_evidence_of_another_time_is_refused(call, tmp_path):
    path, rig = tmp_path / "result.json", tmp_path / "rig.xml"
    rig.write_text(OSCILLATOR.format(damping=1.0), encoding="utf-8")
    late = LEAD | {"location": "spring"}
    late["parameters"] = [{"name": "factor", "value": 0.8}, {"name": "time", "value": 9.0}]
    path.write_bytes(monitored(late))
    table = columns()
    run = write_csv(
        tmp_path / "run.csv",
        {"time": table["time"], "force": table["motor"], "position": table["drive_angle"]},
    )
    words = ("--fit", "spring.damping", "--evidence", tmp_path)
    assert "9 s lies outside" in call("diagnose", rig, run, *words).refused()
