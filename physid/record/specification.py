"""Excitations written as one word, as on a command line: ``mseq:stages=15,clock=0.005``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields

from physid.errors import InputError, available
from physid.record.excitation import Excitation, MSequence, Step
from physid.record.levels import Levels, Pulses, Ramp
from physid.record.noise import LowPass, Noise
from physid.record.sines import Chirp, Multisine

KINDS: Mapping[
    str, type[MSequence | Noise | LowPass | Multisine | Chirp | Step | Ramp | Levels | Pulses]
] = {
    "mseq": MSequence,
    "noise": Noise,
    "lowpass": LowPass,
    "multisine": Multisine,
    "chirp": Chirp,
    "step": Step,
    "ramp": Ramp,
    "levels": Levels,
    "pulses": Pulses,
}
"""The kinds of excitation by the name they have in a specification."""


def parse_excitation(spec: str) -> Excitation:
    """Read an excitation from ``KIND:KEY=VALUE,KEY=VALUE,...``.

    Parameters
    ----------
    spec : str
        For example ``mseq:stages=15,clock=0.005,amplitude=1,periods=2``,
        ``noise:cutoff=20,amplitude=1,duration=10``,
        ``lowpass:cutoff=16,order=2,amplitude=0.1,duration=1``,
        ``multisine:low=0.1,high=10,amplitude=1,duration=10``,
        ``chirp:low=0.1,high=10,amplitude=1,duration=10``,
        ``step:time=1,amplitude=1,duration=10``, ``ramp:amplitude=1,duration=10,periods=2``,
        ``levels:hold=0.2,amplitude=1,duration=10`` or
        ``pulses:width=0.1,rest=1,amplitude=1,duration=10``.

    Returns
    -------
    Excitation

    Raises
    ------
    InputError
        If the kind or a key is unknown (the sentence lists the known ones), a key is missing or
        given twice, or a value is not a number it may be.
    """
    kind, _, rest = spec.partition(":")
    kind = kind.strip()
    if kind not in KINDS:
        raise InputError(f"The excitation '{kind}' does not exist. {available(KINDS)}")
    form = KINDS[kind]
    known = {item.name: item for item in fields(form)}
    values: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in rest.split(","))):
        key, value = _value(kind, known, part)
        if key in values:
            raise InputError(
                f"The key '{key}' of the excitation {kind} is given twice: give it once."
            )
        values[key] = value
    missing = [n for n, item in known.items() if item.default is MISSING and n not in values]
    if missing:
        raise InputError(
            f"The excitation {kind} needs {', '.join(missing)}: add {missing[0]}=VALUE. "
            f"{available(known)}"
        )
    excitation: Excitation = form(**values)  # type: ignore[arg-type]
    return excitation


def _value(kind: str, known: Mapping[str, Field[object]], part: str) -> tuple[str, float]:
    key, text = (piece.strip() for piece in part.partition("=")[::2])
    if key not in known:
        raise InputError(f"The excitation {kind} has no key '{key}'. {available(known)}")
    whole = known[key].type == "int"
    try:
        return key, int(text) if whole else float(text)
    except ValueError as error:
        wanted = "a whole number" if whole else "a number"
        raise InputError(
            f"The key '{key}' of the excitation {kind} needs {wanted}, not '{text}': write "
            f"{key}=VALUE."
        ) from error
