"""Why does a MuJoCo model not match its rig.

Compare a model with measured records, learn which physical effect it lacks, add it, and watch the
error fall.  Everything here is also a command: ``physid --help``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "check": "physid.criticism.checking",
    "compare": "physid.criticism.comparison",
    "diagnose": "physid.criticism.diagnosed",
    "fit": "physid.criticism.comparison",
    "learn": "physid.learning.learning",
    "load_effects": "physid.effects.catalogue",
    "load_model": "physid.effects.catalogue",
    "load_record": "physid.record",
    "monitor": "physid.monitoring.study",
    "refine": "physid.criticism.refinement",
    "simulate": "physid.criticism.simulating",
    "tune": "physid.tuning.study",
    "write_record": "physid.record",
}

if TYPE_CHECKING:
    from physid.criticism.checking import check as check
    from physid.criticism.comparison import compare as compare
    from physid.criticism.comparison import fit as fit
    from physid.criticism.diagnosed import diagnose as diagnose
    from physid.criticism.refinement import refine as refine
    from physid.criticism.simulating import simulate as simulate
    from physid.effects.catalogue import load_effects as load_effects
    from physid.effects.catalogue import load_model as load_model
    from physid.learning.learning import learn as learn
    from physid.monitoring.study import monitor as monitor
    from physid.record import load_record as load_record
    from physid.record import write_record as write_record
    from physid.tuning.study import tune as tune

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public function when it is first used, so that ``import physid`` stays fast."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'physid' has no attribute {name!r}")
