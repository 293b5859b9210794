"""Excitations with the actuators they drive, as one word: ``motor=mseq:stages=9,clock=0.01``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.record.excitation import Excitation
from physid.record.specification import parse_excitation


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """An excitation and what it drives.

    Parameters
    ----------
    excitation : Excitation
    inputs : tuple of str
        All inputs of the model.
    driven : tuple of str
        One input, or two of which the second gets the signal's derivative.
    """

    excitation: Excitation
    inputs: tuple[str, ...]
    driven: tuple[str, ...]

    def sample(self, dt: float, rng: np.random.Generator) -> npt.NDArray[np.float64]:
        """Draw all inputs at 0, dt, 2 dt, ...: (n, nu), zero where nothing is driven."""
        both = len(self.driven) == 2
        draw = self.excitation.sample_with_rate if both else self.excitation.sample
        signal = draw(dt, rng).reshape(-1, len(self.driven))
        values = np.zeros((len(signal), len(self.inputs)))
        values[:, [self.inputs.index(name) for name in self.driven]] = signal
        return values


def parse_drive(text: str, inputs: Sequence[str]) -> Drive:
    """Read ``[ACTUATOR[,ACTUATOR]=]KIND:KEY=VALUE,...``; the first input if none is named.

    Raises
    ------
    InputError
        If an actuator does not exist, there are more than two, or the excitation is malformed.
    """
    name, equals, rest = text.partition("=")
    chosen, spec = (name, rest) if equals and ":" not in name else (inputs[0], text)
    driven = tuple(chosen.split(","))
    for one in driven:
        if one not in inputs:
            raise InputError(f"No actuator is called '{one}'. {available(inputs)}")
    if len(driven) > 2:
        raise InputError(
            f"'{chosen}' names {len(driven)} actuators; give one, or two of which the second gets "
            "the signal's derivative."
        )
    return Drive(excitation=parse_excitation(spec), inputs=tuple(inputs), driven=driven)
