"""Policy steps in a time; pushes and their command-line notation."""

from __future__ import annotations

import math
from dataclasses import dataclass

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE


def policy_steps(time: float) -> int:
    """Number of policy steps in a time [s], rounded up."""
    return math.ceil(time / CASSIE.policy_period - 1e-9)


@dataclass(frozen=True)
class Push:
    """Force on the pelvis for a limited time."""

    time: float
    """Start [s]."""
    force: tuple[float, float, float]
    """Force [N]: to the front of the robot, to its left, and up."""
    duration: float = 4 * CASSIE.policy_period
    """Duration [s], rounded up to whole policy steps."""

    @classmethod
    def parse(cls, text: str) -> Push:
        """Read "time:x,y,z" or "time:x,y,z:duration".

        Raises:
            ConfigurationError: the text has another form.
        """
        try:
            time, force, *duration = text.split(":")
            x, y, z = map(float, force.split(","))
            push = cls(float(time), (x, y, z), *map(float, duration))
        except (ValueError, TypeError):
            push = None
        numbers = () if push is None else (push.time, *push.force, push.duration)
        if push is None or not all(map(math.isfinite, numbers)) or push.duration <= 0:
            raise ConfigurationError(
                f'a push is "time:x,y,z" or "time:x,y,z:duration" in s and N, got {text!r}'
            )
        return push
