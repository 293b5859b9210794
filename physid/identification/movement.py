"""What a varying parameter moves with: time, the size of a variable, or in proportion to one.

The sentence, its significance, and the effect it speaks for (``stiffness_change``,
``switched_damping``), in the contract's form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from physid.identification.reduction import Reduced
from physid.identification.schedule import Scheduled
from physid.identification.segmentation import FLOOR, Segmentation, chosen, segment

SPRINGS = ("stiffness", "kp")
DAMPERS = ("damping", "kv")


@dataclass(frozen=True, slots=True, kw_only=True)
class Movement:
    """A finding on one varying parameter.

    Parameters
    ----------
    parameter : str
    kind : {"constant", "steps", "levels", "proportional", "line"}
    sentence : str
    p_value : float
        That the parameter is constant; corrected for the places tried.
    places : ndarray (k - 1,)
        Times of the steps [s], or thresholds in the variable's unit.
    values : ndarray (k,)
        Of the parameter in each segment.
    std_error : ndarray (k,)
        Of the values, for the colour of the residual; noise in the regressors not counted.
    variable : str
        What it moves with.
    """

    parameter: str
    kind: str
    sentence: str
    p_value: float
    places: np.ndarray
    values: np.ndarray
    std_error: np.ndarray
    variable: str

    def effects(self, speed: str = "m/s") -> list[dict[str, object]]:
        """Return the effects this speaks for; see :func:`evidence`."""
        if self.kind not in ("steps", "levels"):
            return []
        return evidence(self.parameter, self.kind, self.places, self.values, self.std_error, speed)


def evidence(
    parameter: str,
    kind: str,
    places: np.ndarray,
    values: np.ndarray,
    std_error: np.ndarray,
    speed: str = "m/s",
) -> list[dict[str, object]]:
    """Write steps and levels as the effects they speak for, in the contract's form.

    A step of a stiffness is ``stiffness_change``: factor and time.  Each step has one, relative to the
    value before it, so that the factors multiply.  Two levels of a damping are ``switched_damping``:
    factor and speed, relative to the value below the threshold.

    Parameters
    ----------
    parameter : str
        ``ELEMENT.ATTRIBUTE``
    kind : {"steps", "levels"}
    places : ndarray (k - 1,)
        Times [s], or thresholds in the variable's unit.
    values, std_error : ndarray (k,)
        Of the parameter in each segment; an error that is not known is not finite.
    speed : str
        Unit of a threshold.

    Returns
    -------
    list of dict
        Empty where no effect of the catalogue's moves so.
    """
    element, attribute = parameter.rsplit(".", 1)
    stiff = kind == "steps" and attribute in SPRINGS
    damped = kind == "levels" and attribute in DAMPERS and len(places) == 1
    name, other = ("stiffness_change", "time") if stiff else ("switched_damping", "speed")
    unit = "s" if stiff else speed
    return [
        _effect(name, element, _ratio(values, std_error, k), other, float(places[k]), unit)
        for k in range(len(places) if stiff or damped else 0)
        if values[k]
    ]


def _ratio(values: np.ndarray, std_error: np.ndarray, k: int) -> tuple[float, float | None]:
    """Return value k + 1 over value k and its standard error, the two taken as independent."""
    factor = float(values[k + 1] / values[k])
    relative = std_error[k : k + 2] / np.where(values[k : k + 2] != 0, values[k : k + 2], np.inf)
    error = abs(factor) * float(np.hypot(*relative)) if len(relative) == 2 else np.inf
    return factor, error if np.isfinite(error) else None


def _effect(
    name: str,
    location: str,
    factor: tuple[float, float | None],
    other: str,
    value: float,
    unit: str,
) -> dict[str, object]:
    parameters = [
        {"name": "factor", "value": factor[0], "std_error": factor[1], "unit": "1"},
        {"name": other, "value": value, "std_error": None, "unit": unit},
    ]
    return {
        "effect": name,
        "location": location,
        "parameters": parameters,
        "representation": "runtime",
    }


def steps(reduced: Reduced) -> tuple[Movement, Segmentation]:
    """Find when a parameter steps."""
    found = segment(reduced)
    best = found[chosen(found, reduced)]
    times = reduced.time[best.cuts]
    listed = ", ".join(f"{t:.3f}" for t in times)
    kind = "steps" if len(times) else "constant"
    sentence = (
        f"{reduced.name} steps at t = {listed} s, between {_values(best.values)}."
        if len(times)
        else f"{reduced.name} is constant at {best.values[0]:.5g}."
    )
    return _movement(reduced, found[0], best, kind, sentence, times, "time"), best


def levels(
    reduced: Reduced, variable: np.ndarray, label: str, unit: str = ""
) -> tuple[Movement, Segmentation]:
    """Find levels of a parameter by the size of a measured variable (n,).

    A threshold is put half-way between the two samples it separates.
    """
    size = np.abs(variable)
    order = np.argsort(size, kind="stable")
    found = segment(reduced, order)
    best = found[chosen(found, reduced)]
    ranked = size[order]
    thresholds = np.array([0.5 * (ranked[c - 1] + ranked[c]) for c in best.cuts])
    count = {2: "two", 3: "three", 4: "four"}.get(len(best.values), str(len(best.values)))
    listed = ", ".join(f"{t:.4g}" for t in thresholds)
    sentence = (
        f"{reduced.name} has {count} levels, {_values(best.values)}, with threshold |{label}| = "
        f"{listed} {unit}".rstrip()
        + "."
        if len(thresholds)
        else f"{reduced.name} is constant at {best.values[0]:.5g}, whatever {label}."
    )
    kind = "levels" if len(thresholds) else "constant"
    return _movement(reduced, found[0], best, kind, sentence, thresholds, label), best


def in_proportion(reduced: Reduced, found: Scheduled, label: str) -> Movement:
    """Say whether a parameter is proportional to a variable, on a line with it, or constant."""
    constant, slope = found.coefficients
    t = abs(slope) / max(float(found.std_error[1]), 1e-300)
    p_value = float(chi2.sf(min(t, 1e3) ** 2, 1))
    if p_value > 0.01:
        kind, sentence = "constant", f"{reduced.name} does not depend on {label}."
    elif found.proportional:
        kind, sentence = (
            "proportional",
            f"{reduced.name} is proportional to {label}: {slope:.5g} {label}.",
        )
    else:
        kind = "line"
        sentence = f"{reduced.name} moves with {label}: {constant:.5g} + {slope:.5g} {label}."
    return Movement(
        parameter=reduced.name,
        kind=kind,
        sentence=sentence,
        p_value=p_value,
        places=np.zeros(0),
        values=found.coefficients,
        std_error=found.std_error,
        variable=label,
    )


def _values(values: np.ndarray) -> str:
    return " and ".join(f"{v:.5g}" for v in values)


def _movement(
    reduced: Reduced,
    constant: Segmentation,
    best: Segmentation,
    kind: str,
    sentence: str,
    places: np.ndarray,
    variable: str,
) -> Movement:
    return Movement(
        parameter=reduced.name,
        kind=kind,
        sentence=sentence,
        p_value=significance(reduced, constant, best),
        places=places,
        values=best.values,
        std_error=best.std_error[len(best.theta) :],
        variable=variable,
    )


def significance(reduced: Reduced, constant: Segmentation, best: Segmentation) -> float:
    """Return the probability of such a fall of the squares were the parameter constant.

    A likelihood ratio on the independent equations that the residual's colour leaves, times the number
    of places the cuts could have been put (Bonferroni; the plain ratio is wrong where the cuts
    were searched: Andrews, Econometrica 61, 1993).
    """
    k = len(best.cuts)
    if not k:
        return 1.0
    floor = FLOOR**2 * float(np.sum(reduced.target**2))
    ratio = best.information * np.log((constant.misfit + floor) / (best.misfit + floor))
    n = max(best.information, k + 1.0)
    places = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    return float(np.exp(min(chi2.logsf(ratio, 2 * k) + places, 0.0)))
