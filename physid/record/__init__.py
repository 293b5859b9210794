"""What was measured: records, reading and writing them, excitation signals."""

from __future__ import annotations

from physid.record.drive import Drive, parse_drive
from physid.record.excitation import Excitation, MSequence, Step
from physid.record.levels import Levels, Pulses, Ramp
from physid.record.noise import LowPass, Noise
from physid.record.reading import load_record
from physid.record.record import Record, Samples, uniform
from physid.record.sines import Chirp, Multisine
from physid.record.specification import parse_excitation
from physid.record.writing import write_record

__all__ = [
    "Chirp",
    "Drive",
    "Excitation",
    "Levels",
    "LowPass",
    "MSequence",
    "Multisine",
    "Noise",
    "Pulses",
    "Ramp",
    "Record",
    "Samples",
    "Step",
    "load_record",
    "parse_drive",
    "parse_excitation",
    "uniform",
    "write_record",
]
