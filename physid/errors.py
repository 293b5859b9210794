"""The exceptions physid raises, drawn as a tree.

::

    PhysidError                 anything physid reports about a call
    ├── InputError              the call or its files are wrong          exit code 2
    │   ├── RecordError         a record cannot be used
    │   ├── ModelError          a model cannot be loaded or edited
    │   └── OutputError         a result cannot be written
    └── NumericsError           the computation failed                   exit code 3
        ├── DivergedError       a simulation left the finite numbers
        └── ConvergenceError    a fit did not reach a minimum

Each message is one sentence: what was given, what is allowed, what to do.
"""

from __future__ import annotations

from collections.abc import Iterable


class PhysidError(Exception):
    """Base of every error physid raises on purpose."""

    exit_code = 1


class InputError(PhysidError):
    """The call, or a file it names, is wrong."""

    exit_code = 2


class RecordError(InputError):
    """A record cannot be read or does not fit the model."""


class ModelError(InputError):
    """A model cannot be loaded, or a name in it does not exist."""


class OutputError(InputError):
    """A result cannot be written where it was asked for."""


class NumericsError(PhysidError):
    """The computation failed on input that was well formed."""

    exit_code = 3


class DivergedError(NumericsError):
    """A simulation left the finite numbers."""


class ConvergenceError(NumericsError):
    """A fit did not reach a minimum."""


def available(names: Iterable[str]) -> str:
    """Write a list of names as the end of an error sentence.

    Parameters
    ----------
    names : iterable of str
        What the user may write instead.

    Returns
    -------
    str
        ``"Available: a, b, c."`` or ``"None is available."``
    """
    listed = ", ".join(names)
    return f"Available: {listed}." if listed else "None is available."
