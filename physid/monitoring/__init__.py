"""One parameter from prior knowledge, while data arrive: which one changed, when, and by how much."""

from __future__ import annotations

from physid.monitoring.baseline import Window
from physid.monitoring.changes import Hypothesis, Weighed, weigh
from physid.monitoring.design import Choice, candidates, choose, predict
from physid.monitoring.doubt import output_doubt
from physid.monitoring.estimate import Estimate, estimate, instrument, simulate
from physid.monitoring.factors import Factors, factors, numerators
from physid.monitoring.filters import Filter, sampled
from physid.monitoring.lft import Pulled, pull_out
from physid.monitoring.likelihood import Likelihood
from physid.monitoring.patterns import Pattern, compare_patterns
from physid.monitoring.prior import Found, Together, identify, identify_together
from physid.monitoring.recursion import Course, SlidingEstimate
from physid.monitoring.shape import Shape

__all__ = [
    "Choice",
    "Course",
    "Estimate",
    "Factors",
    "Filter",
    "Found",
    "Hypothesis",
    "Likelihood",
    "Pattern",
    "Pulled",
    "Shape",
    "SlidingEstimate",
    "Together",
    "Weighed",
    "Window",
    "candidates",
    "choose",
    "compare_patterns",
    "estimate",
    "factors",
    "identify",
    "identify_together",
    "instrument",
    "numerators",
    "output_doubt",
    "predict",
    "pull_out",
    "sampled",
    "simulate",
    "weigh",
]
