"""Reduced-order model in the world, at the robot that it guides: for pictures, logs, live page.

The reference of a library has no position in the world, but the ghost has one. Its body is at x and
y of the robot's pelvis, at the height of the reference. Its feet are the reference's, rotated by
the yaw of the robot, as in the reward term of the feet; on turns, by that yaw without the deviation
of the body's heading from the mean heading, from which the reference counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from tensordict import TensorDictBase

from aslip.library.footholds import STANCE_SPEED, yaw_rotation
from aslip.robot import SIDES, Side
from aslip.show.palette import LEFT, MODEL, RIGHT, rgba

BODY_COLOR = rgba(MODEL)
"""Colour of the body: red, green, blue and opacity."""
LEG_COLORS: dict[Side, tuple[float, float, float, float]] = {
    "left": rgba(LEFT),
    "right": rgba(RIGHT),
}
"""Colours of the legs in stance."""
SWING_FADE = 0.55
"""Share of white in the colour of a leg in swing."""
BODY_RADIUS, FOOT_RADIUS, WIRE_RADIUS = 0.07, 0.017, 0.0055
"""Radius of the body, the feet, and the wire of the springs [m]."""

_FEET = [f"{side}_foot_position" for side in SIDES]
_FOOT_VELOCITIES = [f"{side}_foot_velocity" for side in SIDES]


@dataclass(frozen=True, eq=False)
class Ghost:
    """One instant of the reduced-order model in the world: a point body on two spring legs."""

    body: np.ndarray
    """(3,) position of the body [m]."""
    left: np.ndarray
    """(3,) position of the left foot [m]."""
    right: np.ndarray
    """(3,) position of the right foot [m]."""
    left_stance: bool = True
    """True if the left leg is in stance."""
    right_stance: bool = True
    """True if the right leg is in stance."""

    def moved(self, offset: np.ndarray) -> Ghost:
        """Ghost moved by an offset (3,) [m, world]."""
        places = {name: getattr(self, name) + offset for name in ("body", "left", "right")}
        return replace(self, **places)

    @classmethod
    def of(cls, tensordict: TensorDictBase, robot: int = 0) -> Ghost:
        """Ghost of the reference of one robot.

        Args:
            tensordict: entries `("reference", ...)` and `("truth", ...)` of n robots.
            robot: index of the robot.
        """
        groups = (cast("TensorDictBase", tensordict.get(name)) for name in ("reference", "truth"))
        return cls.of_rows(*({k: v[robot].numpy() for k, v in group.items()} for group in groups))

    @classmethod
    def of_rows(cls, reference: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray]) -> Ghost:
        """Ghost of one robot's entries of `("reference", ...)` and `("truth", ...)`."""
        body = truth["pelvis_position"].astype(np.float64)
        body[2] = reference["body_position"][2] + np.ravel(truth.get("ground_height", 0.0))[0]
        turn = yaw_rotation(
            truth["pelvis_orientation"], -float(np.ravel(reference.get("body_heading", 0.0))[0])
        )
        left, right = (body + turn @ reference[key] for key in _FEET)
        velocities = (reference[key].tolist() for key in _FOOT_VELOCITIES)
        stance = [math.hypot(*velocity) < STANCE_SPEED for velocity in velocities]
        return cls(body, left, right, *stance)
