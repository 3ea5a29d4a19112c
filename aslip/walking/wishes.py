"""Wishes of callers that robots stand instead of walk."""

from __future__ import annotations

import numpy as np

from aslip.envs import StackEnv
from aslip.errors import ConfigurationError, ShapeError


def can_stand(env: StackEnv) -> bool:
    """True if robots of an environment stand on a wish, see `aslip.transforms.StandClock`."""
    return "stand" in env.observation_spec.keys()  # noqa: SIM118


def checked_wishes(
    env: StackEnv, stand: np.ndarray | None, shape: tuple[int, ...]
) -> np.ndarray | None:
    """Wishes to stand of a shape; None for robots that cannot stand, which walk.

    Raises:
        ShapeError: `stand` has another shape.
        ConfigurationError: a robot shall stand, and the stack has no wish to stand.
    """
    wishes = np.zeros(shape) if stand is None else np.asarray(stand)
    if wishes.shape != shape:
        raise ShapeError(f"stand must be {shape} as the command, got {wishes.shape}")
    if can_stand(env):
        return wishes
    refuse_wish(wishes)
    return None


def refuse_wish(stand: np.ndarray | float) -> None:
    """Raise ConfigurationError if a robot shall stand, in a stack without the wish."""
    if np.any(np.asarray(stand) > 0):
        raise ConfigurationError("robots of this stack cannot stand; see aslip.envs.standing_stack")
