"""The reduced-order model beside the robot it guides, in the world: for pictures, logs, live views.

The library's reference has no place on the floor; here its body goes with the robot's pelvis, at
the reference's height, and its feet where the reference has them relative to the body, turned by
the robot's yaw: the frame in which the reward compares feet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase

from aslip.cassie import SIDES, Side
from aslip.library import GaitLibrary
from aslip.rom import Mode

# a foot of the reference that moves slower over ground is in stance [m/s]
_STANCE_SPEED = 0.05


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
        reference = {key: value[robot].numpy() for key, value in tensordict["reference"].items()}
        truth = cast("TensorDictBase", tensordict["truth"])
        body = truth["pelvis_position"][robot].double().numpy().copy()
        body[2] = reference["body_position"][2]
        turn = yaw_rotation(truth["pelvis_orientation"][robot].double().numpy())
        feet = [body + turn @ reference[f"{side}_foot_position"] for side in SIDES]
        stance = [
            bool(np.linalg.norm(reference[f"{side}_foot_velocity"]) < _STANCE_SPEED)
            for side in SIDES
        ]
        return cls(body, *feet, *stance)


class Footholds:
    """Where the reduced-order model would put its next foot down.

    Args:
        library: the gaits; between two of them the step is interpolated linearly.
    """

    def __init__(self, library: GaitLibrary) -> None:
        self._speeds = library.speeds
        self._phases = np.array([_touchdown_phases(gait.mode, gait.time) for gait in library.gaits])
        speeds = torch.tensor(np.array(library.speeds))[:, None]
        self._steps = np.empty((2, len(speeds), 2))
        for i, side in enumerate(SIDES):
            motion = library.lookup(torch.tensor(self._phases[:, i : i + 1]), speeds)
            left, right = motion.left_foot_position, motion.right_foot_position
            step = left - right if side == "left" else right - left
            self._steps[i] = step[:, :2].double().numpy()

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


def yaw_rotation(orientation: np.ndarray) -> np.ndarray:
    """(3, 3) rotation about the vertical that is part of an orientation (4,), wxyz."""
    w, x, y, z = orientation
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _touchdown_phases(mode: np.ndarray, time: np.ndarray) -> tuple[float, float]:
    """Stride fractions at which left and right foot touch down, from a gait's modes."""
    begins = np.flatnonzero(np.diff(mode)) + 1
    double = [k for k in begins if mode[k] == Mode.DOUBLE]
    after = {int(mode[k - 1]): float(time[k] / time[-1]) for k in double}
    return after[Mode.RIGHT], after[Mode.LEFT]
