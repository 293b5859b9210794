"""How a command ends: the sentence on standard error and the exit code."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType

import typer

from physid.errors import PhysidError

OK = 0
REFUTED = 1
WRONG_CALL = 2
CRASHED = 3
INTERRUPTED = 130

EXTRAS = {"pyarrow": "parquet", "gymnasium": "envs", "statsmodels": "stats"}
"""The extra that installs an optional module."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """Why a command stopped before its result: one sentence and an exit code."""

    sentence: str
    code: int
    cause: BaseException


def explain(error: BaseException) -> Ending:
    """Turn whatever stopped a command into a sentence and an exit code."""
    if isinstance(error, KeyboardInterrupt):
        return Ending(sentence="Interrupted: nothing was written.", code=INTERRUPTED, cause=error)
    if isinstance(error, PhysidError):
        return Ending(sentence=_one_line(str(error)), code=error.exit_code, cause=error)
    if isinstance(error, typer.TyperException):
        return Ending(sentence=_of_usage(error), code=WRONG_CALL, cause=error)
    if isinstance(error, ModuleNotFoundError) and _root(error) in EXTRAS:
        return Ending(sentence=_of_missing_module(error), code=WRONG_CALL, cause=error)
    if isinstance(error, OSError) and error.filename is not None:
        sentence = f"'{error.filename}' cannot be used: {error.strerror}."
        return Ending(sentence=sentence, code=WRONG_CALL, cause=error)
    if isinstance(error, MemoryError):
        sentence = "The memory did not suffice: use a shorter record or fewer of them."
        return Ending(sentence=sentence, code=CRASHED, cause=error)
    detail = _one_line(f"{type(error).__name__}: {error}").rstrip(".:")
    sentence = (
        f"Internal error ({detail}): please report it with the command and what it prints "
        "when PHYSID_DEBUG=1 is set."
    )
    return Ending(sentence=sentence, code=CRASHED, cause=error)


def complain(ending: Ending) -> int:
    """Write the sentence on standard error and return the exit code."""
    if debugging():
        traceback.print_exception(ending.cause, file=sys.stderr)
    with contextlib.suppress(OSError):
        sys.stderr.write(f"physid: {ending.sentence}\n")
    return ending.code


def debugging() -> bool:
    """Whether PHYSID_DEBUG asks for tracebacks and warnings."""
    return os.environ.get("PHYSID_DEBUG", "0") not in ("", "0")


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Treat a request to terminate like Ctrl-C, and keep library warnings off the screen.

    Everything is as before when the block is left.
    """
    with warnings.catch_warnings():
        if not debugging():
            warnings.simplefilter("ignore")
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        former = signal.signal(signal.SIGTERM, _interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGTERM, former)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _of_usage(error: typer.TyperException) -> str:
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "physid"
    return f"{_sentence(error.format_message())} See '{path} --help'."


def _of_missing_module(error: ModuleNotFoundError) -> str:
    module = _root(error)
    extra = EXTRAS[module]
    return (
        f"This needs {module}, which is not installed: run pip install 'physid[{extra}]' "
        "(in a checkout, pip install '.[" + extra + "]')."
    )


def _root(error: ModuleNotFoundError) -> str:
    return (error.name or "").partition(".")[0]


def _sentence(text: str) -> str:
    line = _one_line(text)
    return line if line.endswith((".", "?", "!")) else f"{line}."


def _one_line(text: str) -> str:
    return " ".join(text.split())
