"""Stable proper factors around one parameter: from a record's u and y to x and z with z = delta x.

One deviation of rank one, one output, any number of inputs.  With the numerators of KU (8) over the
common denominator det P0, P0(s) = M s^2 + D s + K,

    z = (d y - n11 u) / n12,     x = (n22 y - n0 u) / n12,     n11 n22 - n12 n21 = d n0,

are exact for every delta.  Both are passed through F = W n12 / r, W = 1/(T s + 1)^order, so that
z = D0 y - N0 u and x = V u + U y, KU (10)-(11), are stable and proper.  The choice of r:

- ``input``: r = n21, KU (9) and (29): the zeros between an input and x must be stable;
- ``filter``: r = 1, W does all: no zero of the rig is inverted, at the price of a higher order;
- ``plant``: r = d: with W = 1 this is the output error linearised at the nominal model, whose noise is
  as white as the sensor's; the nominal rig must be stable.

What happens between samples is exact for held inputs: only the difference to the nominal rig's y is joined
by straight lines.  Joined whole, y would hide its jumps of acceleration, which W of least order lets
through: 0.01 % of KU's k3 without noise, 0.07 % at 1/T = 30.  An unstable nominal rig leaves no other way.

Zeros of r at the origin (a rig that turns freely, a parameter that acts on speed) are left out of it,
as KU (19) does.  Signs are those of R = +delta; KU (19) as printed has the other one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.errors import ModelError
from physid.monitoring.filters import Filter, sampled
from physid.monitoring.lft import Pulled
from physid.monitoring.shape import Shape

TRIMMED = 1e-13
"""Coefficient, relative to the largest a determinant of such rows can have, that is round-off."""
ORIGIN = 1e-7
"""Zero, relative to the rig's own speed, that lies at the origin."""
CONSTANT = 1e-9
"""Constant force or reading, relative to the largest per unit of motion, that is round-off."""
SLOW = 10.0
"""A zero that decays more slowly than the record over this has a note."""
UNSTABLE = 1e-6
"""Real part of a pole, relative to the rig's own speed, from which it is unstable; free turning is not."""
REFERENCES = ("input", "filter", "plant")

StateSpace = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Numerators:
    """Polynomials of one parameter, one output and the inputs, in s / speed, lowest power first.

    Parameters
    ----------
    speed : float
        Unit of s [rad/s].
    d, n12, n22 : ndarray
    n11, n21, n0 : tuple of ndarray
        One per input.
    rig : tuple of ndarray
        The nominal rig (a, b, c, d) from the inputs to (y, x), its time in s.
    """

    speed: float
    d: np.ndarray
    n12: np.ndarray
    n22: np.ndarray
    n11: tuple[np.ndarray, ...]
    n21: tuple[np.ndarray, ...]
    n0: tuple[np.ndarray, ...]
    rig: StateSpace

    def zeros(self, polynomial: np.ndarray) -> np.ndarray:
        """Return the roots of a polynomial [rad/s]."""
        return np.asarray(self.speed * np.roots(polynomial[::-1]))


def numerators(pulled: Pulled, parameter: int, output: int) -> Numerators:
    """Return the polynomials by bordered determinants on a circle and a Fourier transform.

    Raises
    ------
    ModelError
        If the deviation has a rank above one, or the output does not show it.
    """
    loops = np.flatnonzero(pulled.owners == parameter)
    name = pulled.names[parameter]
    if len(loops) != 1:
        raise ModelError(
            f"{name} enters with rank {len(loops)}, but one output shows only rank one: fit it by output "
            "error (physid fit), which needs no inversion."
        )
    if _off_rest(pulled, int(loops[0]), output):
        raise ModelError(
            f"{name} is seen beside a constant load or offset, but these factors need positions counted from "
            "rest: fit it by output error (physid fit)."
        )
    k, d, m, g = pulled.balance()
    nv, nu = len(k), g.shape[1]
    speed = _speed(k, m)
    left, right = pulled.left[:, loops], pulled.right[loops[0]]
    sensor = pulled.sensors[output, 1:]
    count = 2 * (2 * nv + 2) + 1
    points = np.exp(2j * np.pi * np.arange(count) / count)

    def fit(rows: list[np.ndarray], columns: list[np.ndarray], corner: np.ndarray) -> np.ndarray:
        values, largest = [], 0.0
        for point in points:
            s = point * speed
            size = np.concatenate([np.ones(nv), s * np.ones(nv), s**2 * np.ones(nv)])
            p0 = k + d * s + m * s**2
            below = [(row * size).reshape(3, nv).sum(axis=0) for row in rows]
            if rows:
                p0 = np.block([[p0, np.hstack(columns)], [np.array(below), corner]])
            values.append(np.linalg.det(p0))
            largest = max(largest, float(np.prod(np.linalg.norm(p0, axis=1))))  # Hadamard's bound
        return _trimmed(np.real(np.fft.fft(values)) / count, TRIMMED * largest)

    x, u_direct = right[1 : 1 + 3 * nv], right[1 + 3 * nv :]
    zero = np.zeros((1, 1))
    n12 = fit([sensor], [left], zero)
    if not np.any(n12):
        raise ModelError(f"{pulled.outputs[output]} does not show {name}; choose another sensor.")
    columns = [g[:, [i]] for i in range(nu)]
    a, b, c, direct = pulled.state_space()
    rows = [output, len(pulled.outputs) + int(loops[0])]
    return Numerators(
        speed=speed,
        d=fit([], [], zero),
        n12=n12,
        n22=fit([x], [left], zero),
        n11=tuple(fit([sensor], [c], zero) for c in columns),
        n21=tuple(fit([x], [c], np.array([[v]])) for c, v in zip(columns, u_direct, strict=True)),
        n0=tuple(
            fit([sensor, x], [c, left], np.array([[0.0, 0.0], [v, 0.0]]))
            for c, v in zip(columns, u_direct, strict=True)
        ),
        rig=(a, b[:, :nu], c[rows], direct[rows, :nu]),
    )


def _off_rest(pulled: Pulled, loop: int, output: int) -> bool:
    """Tell whether something constant acts beside the motion, above round-off."""
    full = pulled.plant.balance(pulled.nominal)
    rows = (full, pulled.right[[loop]], pulled.sensors[[output]])
    return any(np.abs(row[:, 0]).max() > CONSTANT * np.abs(row).max() for row in rows)


def _speed(k: np.ndarray, m: np.ndarray) -> float:
    """Return the geometric middle of the rig's natural frequencies [rad/s]."""
    squares = np.abs(np.linalg.eigvals(np.linalg.solve(m, k)))
    seen = squares[squares > 1e-12 * max(float(squares.max()), 1e-300)]
    return float(np.exp(0.5 * np.mean(np.log(seen)))) if len(seen) else 1.0


def _trimmed(coefficients: np.ndarray, negligible: float) -> np.ndarray:
    found = np.where(np.abs(coefficients) > negligible, coefficients, 0.0)
    kept = np.flatnonzero(found)
    return np.asarray(found[: kept[-1] + 1]) if len(kept) else np.zeros(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Factors:
    """Filters of one parameter.

    Parameters
    ----------
    shape : Shape
    filter : Filter
        From (y, u_1, ...) to (z, x).
    sensor : Filter
        From the sensor alone: D0 and U.
    zeros : ndarray of complex
        What F inverts [rad/s].
    notes : tuple of str
        Slow zeros.
    """

    shape: Shape
    filter: Filter
    sensor: Filter
    zeros: np.ndarray
    notes: tuple[str, ...] = ()

    def signals(self, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return z and x (runs, n) of runs of y (runs, n) and u (runs, n, nu), from rest."""
        both = self.filter.run(np.concatenate([y[:, :, None], u], axis=2))
        return both[:, :, 0], both[:, :, 1]

    def error(self, delta: float) -> Filter:
        """Return the filter from the sensor's noise to z - delta x."""
        return self.sensor.select(np.array([[1.0, -delta]]), [0])

    def regressor(self) -> Filter:
        """Return the filter from the sensor's noise to x."""
        return self.sensor.select(np.array([[0.0, 1.0]]), [0])


def least_order(found: Numerators, reference: str = "input", source: int = 0) -> int:
    """Return the least order of W that makes the factors proper."""
    below = _reference(found, reference, source)
    return max(max(len(p) for p in (found.d, found.n22, *found.n11, *found.n0)) - len(below), 0)


def factors(
    found: Numerators, shape: Shape, dt: float, *, duration: float | None = None
) -> Factors:
    """Return the filters that make x and z of a record's samples.

    Parameters
    ----------
    found : Numerators
    shape : Shape
    dt : float
        [s]
    duration : float, optional
        Of the record [s]: slower zeros than that have a note.

    Raises
    ------
    ModelError
        If the order of W is too low, or a zero that would be inverted is unstable.
    """
    least = least_order(found, shape.reference, shape.source)
    if shape.order < least:
        raise ModelError(
            f"The order {shape.order} of W is too low: these factors are proper from order {least}."
        )
    below = _reference(found, shape.reference, shape.source)
    zeros = found.zeros(below)
    notes = check_zeros(zeros, duration)
    top, bottom = shape.polynomials(found.speed)
    denominator = np.convolve(below, bottom)

    def chain(*tops: np.ndarray) -> StateSpace:
        a, b, c, d = _chain(tuple(np.convolve(t, top) for t in tops), denominator)
        return a * found.speed, b * found.speed, c, d

    sensor = sampled(*chain(found.d, found.n22), dt, [True])
    poles = found.zeros(found.d)
    if np.any(poles.real > UNSTABLE * found.speed):
        parts = [chain(-a, -b) for a, b in zip(found.n11, found.n0, strict=True)]
        inputs = sampled(*_beside(parts), dt, [False] * len(parts))
        whole = _summed(sensor, inputs)
    else:
        whole = _about_nominal(sensor, found.rig, chain(found.n12), dt)
    return Factors(shape=shape, filter=whole, sensor=sensor, zeros=zeros, notes=notes)


def _about_nominal(sensor: Filter, rig: StateSpace, chain: StateSpace, dt: float) -> Filter:
    """Return z = D0 (y - y0) and x = U (y - y0) + F x0, the nominal rig's y0 and x0 under held inputs.

    D0 y0 = N0 u and F x0 = V u + U y0 exactly, so these are the same z and x.  But only y - y0 is joined
    by straight lines: it is small where delta is, and smooth where the inputs jump.
    """
    from scipy.linalg import block_diag

    a, b, c, d = rig
    fa, fb, fc, fd = chain
    k, m, nu = len(a), len(fa), b.shape[1]
    together = np.block([[a, np.zeros((k, m))], [fb @ c[1:], fa]])
    readings = np.block([[c[:1], np.zeros((1, m))], [fd @ c[1:], fc]])
    driven, direct = np.vstack([b, fb @ d[1:]]), np.vstack([d[:1], fd @ d[1:]])
    nominal = sampled(together, driven, readings, direct, dt, [False] * nu)
    mixed, zeros = block_diag(nominal.a, sensor.a), np.zeros((k + m, 1))
    mixed[k + m :, : k + m] = -sensor.b @ nominal.c[:1]
    below = np.hstack([sensor.b, -sensor.b @ nominal.d[:1]])
    lifted = np.vstack([np.zeros((1, k + m)), nominal.c[1:]])
    held = np.vstack([np.zeros((1, nu)), nominal.d[1:]])
    return Filter(
        a=mixed,
        b=np.vstack([np.hstack([zeros, nominal.b]), below]),
        c=np.hstack([lifted - sensor.d @ nominal.c[:1], sensor.c]),
        d=np.hstack([sensor.d, held - sensor.d @ nominal.d[:1]]),
        dt=dt,
    )


def _summed(one: Filter, other: Filter) -> Filter:
    """Return the filter of both's inputs whose outputs are the sums of theirs."""
    from scipy.linalg import block_diag

    return Filter(
        a=block_diag(one.a, other.a),
        b=block_diag(one.b, other.b),
        c=np.hstack([one.c, other.c]),
        d=np.hstack([one.d, other.d]),
        dt=one.dt,
    )


def check_zeros(zeros: np.ndarray, duration: float | None = None) -> tuple[str, ...]:
    """Return notes on slow zeros.

    Raises
    ------
    ModelError
        If one is unstable.
    """
    if np.any(zeros.real >= 0.0):
        worst = zeros[np.argmax(zeros.real)]
        raise ModelError(
            f"A zero at {worst:.4g} rad/s would be inverted and is not stable: choose another sensor or "
            "another input, or a reference that inverts no zero of the rig (filter)."
        )
    slow = zeros[zeros.real * (duration or 0.0) > -SLOW] if duration else zeros[:0]
    if not len(slow):
        return ()
    longest = 1.0 / float(-slow.real.max())
    return (
        f"The factors invert a zero that decays in {longest:.3g} s: the filters must start with the rig at "
        "rest, or their start must be estimated.",
    )


def _reference(found: Numerators, reference: str, source: int) -> np.ndarray:
    """Return r without its zeros at the origin."""
    if reference not in REFERENCES:
        raise ModelError(
            f"The reference '{reference}' does not exist. Available: {', '.join(REFERENCES)}."
        )
    if reference == "filter":
        return np.ones(1)
    below = found.d if reference == "plant" else found.n21[source]
    if not np.any(below):
        raise ModelError("This input does not reach the parameter; choose another.")
    size = np.abs(below).max()
    origin = int(np.flatnonzero(np.abs(below) > ORIGIN * size)[0])
    return np.asarray(below[origin:] / size)


def _chain(tops: tuple[np.ndarray, ...], bottom: np.ndarray) -> StateSpace:
    """Return one input's companion form, an output per numerator; lowest powers first."""
    n = len(bottom) - 1
    monic = bottom / bottom[-1]
    a = np.zeros((n, n))
    a[:-1, 1:] = np.eye(n)[:-1, :-1] if n > 1 else np.zeros((0, 0))
    b, c, d = np.zeros((n, 1)), np.zeros((len(tops), n)), np.zeros((len(tops), 1))
    if n:
        a[-1], b[-1, 0] = -monic[:-1], 1.0
    for i, top in enumerate(tops):
        full = np.zeros(n + 1)
        full[: len(top)] = top / bottom[-1]
        d[i, 0] = full[n]
        c[i] = full[:n] - full[n] * monic[:-1]
    return a, b, c, d


def _beside(parts: list[StateSpace]) -> StateSpace:
    """Add chains of one input each that share their outputs."""
    from scipy.linalg import block_diag

    a = block_diag(*(p[0] for p in parts))
    b = block_diag(*(p[1] for p in parts))
    return a, b, np.hstack([p[2] for p in parts]), np.hstack([p[3] for p in parts])
