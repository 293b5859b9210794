"""How a command ends when it does not reach its result."""

import os
import signal
import subprocess
import sys
import time

import pytest

import physid
from physid.errors import ConvergenceError, DivergedError, InputError, RecordError


def raising(error):
    def study(*arguments, **options):
        raise error

    return study


@pytest.fixture
def stubbed(monkeypatch):
    """Replace ``physid.fit`` by something that raises."""

    def replace(error):
        monkeypatch.setattr(physid, "fit", raising(error), raising=False)

    return replace


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("Give two."), 2),
        (RecordError("Row 3 repeats."), 2),
        (DivergedError("Joint 'load' diverged at 0.3 s."), 3),
        (ConvergenceError("No minimum was found."), 3),
        (FileNotFoundError(2, "No such file or directory", "mesh.obj"), 2),
        (MemoryError(), 3),
    ],
)
def test_known_errors(call, stubbed, error, code):
    stubbed(error)
    sentence = call("fit", "model.xml", "record.csv").refused(code)
    assert str(error) in sentence or code == 2 or isinstance(error, MemoryError)


def test_sentence_stays_on_one_line(call, stubbed):
    stubbed(InputError("Line one.\n  Line two."))
    assert call("fit", "model.xml", "record.csv").refused() == "Line one. Line two."


def test_unexpected_error_asks_for_a_report(call, stubbed):
    stubbed(ZeroDivisionError("division by zero"))
    sentence = call("fit", "model.xml", "record.csv").refused(code=3)
    assert "ZeroDivisionError: division by zero" in sentence
    assert "report" in sentence


def test_traceback_on_request(call, stubbed, monkeypatch):
    monkeypatch.setenv("PHYSID_DEBUG", "1")
    stubbed(ZeroDivisionError())
    outcome = call("fit", "model.xml", "record.csv")
    assert outcome.code == 3
    assert "Traceback" in outcome.err


def test_missing_optional_module_names_the_extra(call, stubbed):
    stubbed(ModuleNotFoundError("No module named 'pyarrow'", name="pyarrow.parquet"))
    assert "physid[parquet]" in call("fit", "model.xml", "record.parquet").refused()


def test_missing_required_module_is_internal(call, stubbed):
    stubbed(ModuleNotFoundError("No module named 'numpy'", name="numpy"))
    assert "numpy" in call("fit", "model.xml", "record.csv").refused(code=3)


def test_interruption(call, stubbed, tmp_path):
    stubbed(KeyboardInterrupt())
    out = tmp_path / "out"
    assert "Interrupted" in call("fit", "model.xml", "record.csv", "--out", out).refused(130)
    assert not out.exists()


def test_demo_leaves_nothing_when_interrupted(call, monkeypatch, tmp_path):
    monkeypatch.setattr(physid, "refine", raising(KeyboardInterrupt()), raising=False)
    out = tmp_path / "demo"
    assert call("demo", "--out", out).code == 130
    assert not out.exists()
    out.mkdir()
    (out / "mine.txt").write_text("kept", encoding="utf-8")
    assert call("demo", "--out", out).code == 130
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


SLEEPER = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
import physid
from physid.cli import main

def fit(*arguments, **options):
    open(sys.argv[1], "w").close()
    time.sleep(60)

physid.fit = fit
sys.exit(main(["fit", "model.xml", "record.csv", "--json"]))
"""


@pytest.mark.skipif(os.name == "nt", reason="signals as on POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_running_command(number, tmp_path):
    begun = tmp_path / "begun"
    words = [sys.executable, "-c", SLEEPER, str(begun)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while not begun.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert out == ""
    assert err.startswith("physid: Interrupted")
    assert "Traceback" not in err


def test_handlers_are_put_back(call, stubbed):
    before = signal.getsignal(signal.SIGTERM)
    stubbed(InputError("No."))
    call("fit", "model.xml", "record.csv")
    assert signal.getsignal(signal.SIGTERM) is before
