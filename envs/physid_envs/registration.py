"""The environments by name, as Gymnasium keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium

from physid_envs.rigs import MOST_STEPS, NAMES

ENTRY = "physid_envs.environment:RigEnv"
VECTOR_ENTRY = "physid_envs.batched:BatchedRigEnv"


def environment_ids() -> dict[str, dict[str, Any]]:
    """Return every environment's id and what its constructor is given."""
    ids: dict[str, dict[str, Any]] = {
        f"physid/{name}-v0": {"model": rig} for name, rig in NAMES.items()
    }
    return {**ids, "physid/Rig-v0": {}}


def register_all(registry: Mapping[str, Any]) -> None:
    """Register every environment that is not in the registry yet."""
    for name, kwargs in environment_ids().items():
        if name not in registry:
            gymnasium.register(
                id=name,
                entry_point=ENTRY,
                vector_entry_point=VECTOR_ENTRY,
                max_episode_steps=MOST_STEPS,
                order_enforce=False,  # the environment says so itself, with what to do
                kwargs=kwargs,
            )
