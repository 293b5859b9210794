"""Identification by iterative learning control: parameters learned by flying again and again."""

from __future__ import annotations

from physid.learning.design import (
    Expectation,
    Proposal,
    expect,
    identifiable,
    indistinct,
    propose,
)
from physid.learning.estimation import Estimate
from physid.learning.learning import Experiment, Learned, learn
from physid.learning.loop import Command, Flight, left_limits
from physid.learning.plant import ParametricPlant, parametric_plant
from physid.learning.reference import Reference
from physid.learning.rules import Averaging, InformationWeighted, Published, Rising, Rule
from physid.learning.sensors import Sensors
from physid.learning.setup import Setup
from physid.learning.trial import LinearExperiment

__all__ = [
    "Averaging",
    "Command",
    "Estimate",
    "Expectation",
    "Experiment",
    "Flight",
    "InformationWeighted",
    "Learned",
    "LinearExperiment",
    "ParametricPlant",
    "Proposal",
    "Published",
    "Reference",
    "Rising",
    "Rule",
    "Sensors",
    "Setup",
    "expect",
    "identifiable",
    "indistinct",
    "learn",
    "left_limits",
    "parametric_plant",
    "propose",
]
