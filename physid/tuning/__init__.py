"""Gains tuned from one experiment on a closed loop, kept stable by what the record says."""

from __future__ import annotations

from physid.tuning.certificate import Certificate
from physid.tuning.constraints import (
    CONSTRAINTS,
    Constraint,
    HalfPlane,
    InterGrid,
    Margins,
    Nyquist,
    NyquistOpen,
    SmallGain,
    Unconstrained,
)
from physid.tuning.experiment import Experiment, experiment_of
from physid.tuning.loop import LinearPlant, sampled
from physid.tuning.tuning import Tuned, tune_gain

__all__ = [
    "CONSTRAINTS",
    "Certificate",
    "Constraint",
    "Experiment",
    "HalfPlane",
    "InterGrid",
    "LinearPlant",
    "Margins",
    "Nyquist",
    "NyquistOpen",
    "SmallGain",
    "Tuned",
    "Unconstrained",
    "experiment_of",
    "sampled",
    "tune_gain",
]
