"""The reduced-order model beside the robot it guides, in the world: for pictures, logs, live views.

The library's reference has no place on the floor; here its body goes with the robot's pelvis, at
the reference's height, and its feet where the reference has them relative to the body, turned by
the robot's yaw: the frame in which the reward compares feet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import SIDES, Side
from aslip.rom import Gait, Mode
from aslip.show.palette import LEFT, MODEL, RIGHT, rgba

# a foot of the reference that moves slower over ground is in stance [m/s]
_STANCE_SPEED = 0.05

BODY_COLOR = rgba(MODEL)
"""Of its body wherever it is drawn, red, green, blue and opacity."""
LEG_COLORS: dict[Side, tuple[float, float, float, float]] = {
    "left": rgba(LEFT),
    "right": rgba(RIGHT),
}
"""Of its legs in stance."""
SWING_FADE = 0.55
"""How much of a swing leg's colour is replaced by white."""
BODY_RADIUS, FOOT_RADIUS, WIRE_RADIUS = 0.07, 0.017, 0.0055
"""Of its body, its feet, and the wire of its springs [m]."""

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
    """Whether the left leg carries."""
    right_stance: bool = True
    """Whether the right leg carries."""

    @classmethod
    def of(cls, tensordict: TensorDictBase, robot: int = 0) -> Ghost:
        """The reference of one robot, above the place where the robot is.

        Args:
            tensordict: has `("reference", ...)` and `("truth", ...)` of n robots.
            robot: which of them.
        """
        groups = (cast("TensorDictBase", tensordict.get(name)) for name in ("reference", "truth"))
        return cls.of_rows(*({k: v[robot].numpy() for k, v in group.items()} for group in groups))

    @classmethod
    def of_rows(cls, reference: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray]) -> Ghost:
        """The same from one robot's entries of `("reference", ...)` and `("truth", ...)`."""
        body = truth["pelvis_position"].astype(np.float64)
        body[2] = reference["body_position"][2]
        turn = yaw_rotation(truth["pelvis_orientation"])
        left, right = (body + turn @ reference[key] for key in _FEET)
        velocities = (reference[key].tolist() for key in _FOOT_VELOCITIES)
        stance = [math.hypot(*velocity) < _STANCE_SPEED for velocity in velocities]
        return cls(body, left, right, *stance)


class Footholds:
    """Where the reduced-order model would put its next foot down.

    Args:
        library: the gaits; between two of them the step is interpolated linearly.

    Raises:
        ConfigurationError: the library has motions, but no gaits.
    """

    def __init__(self, library: GaitLibrary) -> None:
        if not library.gaits:
            raise ConfigurationError(
                "footholds are planned from gaits, and this library, of a pendulum's motion or a"
                " single reference, has none; leave it out for the library that ships"
            )
        self._speeds = library.speeds
        self._phases = np.array([touchdown_phases(gait) for gait in library.gaits])
        self._strides = np.array([gait.stride for gait in library.gaits])
        speeds = torch.tensor(np.array(library.speeds))[:, None]
        self._steps = np.empty((2, len(speeds), 2))
        for i, side in enumerate(SIDES):
            motion = library.lookup(torch.tensor(self._phases[:, i : i + 1]), speeds)
            left, right = motion.left_foot_position, motion.right_foot_position
            step = left - right if side == "left" else right - left
            self._steps[i] = step[:, :2].double().numpy()

    def stride(self, speed: float) -> float:
        """Duration of a stride of the reduced-order model [s]."""
        return float(np.interp(speed, self._speeds, self._strides))

    def touchdown_phase(self, side: Side, speed: float) -> float:
        """Stride fraction at which a foot of the reduced-order model touches down."""
        return float(np.interp(speed, self._speeds, self._phases[:, SIDES.index(side)]))

    def step(self, side: Side, speed: float) -> np.ndarray:
        """(2,) from the stance foot to the foot that touches down, forward and left [m]."""
        steps = self._steps[SIDES.index(side)]
        return np.array([np.interp(speed, self._speeds, steps[:, axis]) for axis in range(2)])

    def planned(
        self, side: Side, speed: float, stance_foot: np.ndarray, orientation: np.ndarray
    ) -> np.ndarray:
        """Where a foot should touch down, (2,) [m, world].

        The stance foot's actual place plus the reduced-order model's step, as in the paper's
        comparison (Sec. V-A), turned by the robot's yaw.

        Args:
            side: the foot in swing.
            speed: commanded speed [m/s].
            stance_foot: (3,) sole centre of the other foot [m, world].
            orientation: (4,) of the pelvis, wxyz.
        """
        turn = yaw_rotation(orientation)[:2, :2]
        return stance_foot[:2] + turn @ self.step(side, speed)


def heading(orientation: np.ndarray) -> np.ndarray:
    """(*b,) turn about the vertical of orientations (*b, 4), wxyz [rad]."""
    w, x, y, z = np.moveaxis(np.asarray(orientation, dtype=np.float64), -1, 0)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def yaw_rotation(orientation: np.ndarray) -> np.ndarray:
    """(3, 3) rotation about the vertical that is part of an orientation (4,), wxyz."""
    yaw = float(heading(orientation))
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def touchdown_phases(gait: Gait) -> tuple[float, float]:
    """Stride fractions at which left and right foot of a gait touch down."""
    mode, time = gait.mode, gait.time
    begins = np.flatnonzero(np.diff(mode)) + 1
    double = [k for k in begins if mode[k] == Mode.DOUBLE]
    after = {int(mode[k - 1]): float(time[k] / time[-1]) for k in double}
    return after[Mode.RIGHT], after[Mode.LEFT]
