"""Errors of the environments, which are both physid's and Gymnasium's."""

from __future__ import annotations

from gymnasium.error import ResetNeeded

from physid.errors import InputError


class ResetNeededError(InputError, ResetNeeded):
    """A step was asked for outside an episode."""


class DrawingError(InputError):
    """A picture was asked for where none can be drawn."""
