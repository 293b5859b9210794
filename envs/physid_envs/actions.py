"""Actions at the boundary: the right shape, and finite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from physid.errors import InputError


def checked_actions(
    given: npt.ArrayLike, names: Sequence[str], copies: int | None = None
) -> npt.NDArray[np.float64]:
    """Return actions as an array of their own.

    Parameters
    ----------
    given : array_like (nu,) or (copies, nu)
    names : sequence of str
        Inputs, for messages.
    copies : int, optional
        Rows expected.

    Raises
    ------
    InputError
        If the shape is another or a value is not finite.
    """
    shape = (len(names),) if copies is None else (copies, len(names))
    try:
        actions = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"The action {given!r} is not {shape[-1]} numbers.") from None
    if actions.shape != shape:
        raise InputError(
            f"The action has shape {actions.shape}, but must have {shape}: a value per actuator "
            f"({', '.join(names)})."
        )
    finite = np.isfinite(actions)
    if not finite.all():
        first = names[int(np.argwhere(~finite)[0][-1])]
        raise InputError(
            f"The action for '{first}' is not finite; every action must be a finite number."
        )
    return actions
