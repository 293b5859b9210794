"""Feedback of an observer's state: the same formulas, with what the observer estimates as x."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import ConvergenceError, InputError
from physid.tuning.loop import LinearPlant, respond

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observer:
    r"""An observer on the nominal plant.

    .. math:: \hat x_{k+1} = A \hat x_k + B u_k + L (y_k - C \hat x_k)

    Parameters
    ----------
    plant : LinearPlant
        A and B, nominal.
    outputs : ndarray, shape (p, n)
        C.
    correction : ndarray, shape (n, p)
        L.

    Notes
    -----
    From v to x^ in the loop with F0, H contains the plant, known or not, and the observer:
    det(I + (F - F0) H) is again the ratio of the characteristic polynomials with F and with F0, so
    constraints and certificate hold as they stand. The record must be of the loop with this very
    observer, started at zero.
    """

    plant: LinearPlant
    outputs: Array
    correction: Array

    def estimate(self, inputs: Array, measured: Array) -> Array:
        """Return x^, shape (t, n), from u (t, m) and y (t, p), from rest."""
        a = self.plant.a - self.correction @ self.outputs
        return respond(a, np.hstack([self.plant.b, self.correction]), np.hstack([inputs, measured]))


def design_observer(
    plant: LinearPlant,
    outputs: Array,
    *,
    disturbance: Array | None = None,
    noise: Array | float = 1e-2,
) -> Observer:
    """Design a steady Kalman filter for a disturbed plant.

    Parameters
    ----------
    plant : LinearPlant
        Nominal.
    outputs : ndarray, shape (p, n)
        C.
    disturbance : ndarray, shape (n, g), optional
        How independent disturbances of unit variance move the states in a sample; by default as
        the inputs do. Disturbances of every acceleration make an observer that trusts the nominal
        model less.
    noise : float or ndarray, shape (p,)
        Standard deviation of the sensors [their unit].

    Raises
    ------
    InputError
        If C has another number of columns.
    ConvergenceError
        If the outputs do not determine the state.
    """
    import control

    if outputs.ndim != 2 or outputs.shape[1] != len(plant.a):
        raise InputError(
            f"The outputs {outputs.shape} do not read the plant's {len(plant.a)} states: give a row "
            "per output, a column per state."
        )
    weights = np.diag(np.broadcast_to(np.asarray(noise, dtype=np.float64) ** 2, len(outputs)))
    g = plant.b if disturbance is None else disturbance
    try:
        gain, _, _ = control.dlqe(plant.a, g, outputs, np.eye(g.shape[1]), weights)
    except (np.linalg.LinAlgError, ValueError, control.ControlArgument) as error:
        raise ConvergenceError(
            f"No observer follows the plant from these outputs ({error}): measure more of them."
        ) from None
    found = Observer(plant=plant, outputs=outputs, correction=np.asarray(gain))
    if not np.abs(np.linalg.eigvals(plant.a - found.correction @ outputs)).max() < 1.0:
        raise ConvergenceError(
            "No stable observer follows the plant from these outputs: measure more of them, or give "
            "a larger noise."
        )
    return found


def observed_loop(
    plant: LinearPlant, outputs: Array, observer: Observer, gain: Array
) -> LinearPlant:
    """Return the loop u = -F x^ + v from v to (x, x^), the plant being another than the nominal.

    Parameters
    ----------
    plant : LinearPlant
        The true plant.
    outputs : ndarray, shape (p, n)
        How its states are measured.
    observer : Observer
    gain : ndarray, shape (m, n)
    """
    own, k = observer.plant, observer.correction
    a = np.block(
        [
            [plant.a, -plant.b @ gain],
            [k @ outputs, own.a - k @ observer.outputs - own.b @ gain],
        ]
    )
    return LinearPlant(a=a, b=np.vstack([plant.b, own.b]), dt=plant.dt)
