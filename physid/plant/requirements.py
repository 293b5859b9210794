"""What some methods ask of a model."""

from __future__ import annotations

from physid.errors import ModelError
from physid.plant.memory import beyond_motion
from physid.plant.model import Model


def require_motion_alone(model: Model, method: str) -> None:
    """Refuse a model whose forces or readings depend on more than its motion and its input.

    Parameters
    ----------
    model : Model
    method : str
        What asks for it, as the subject of a sentence.

    Raises
    ------
    ModelError
        Naming the effect.
    """
    found = beyond_motion(model.effects)
    if found:
        raise ModelError(
            f"{method} needs forces and readings that follow from the motion, but "
            f"{model.site(found[0])} has a memory, depends on the time or sits at a sensor: leave it "
            "out, or use physid fit."
        )
