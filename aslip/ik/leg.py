"""Both legs as arrays: a batched kinematic chain whose geometry is read from Pinocchio's model.

Pinocchio evaluates one configuration per call, so calling it from Python costs more than the
mathematics. The same placements in NumPy arrays serve a whole library of poses at once. Everything
is in the pelvis frame, with leading axes (n, 2): instants, sides (left first).
"""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from aslip.ik.mjcf import DRAWN
from aslip.ik.rotation import rotate
from aslip.robot import SIDES, Side, foot_site

JOINTS = (
    "hip_roll", "hip_yaw", "hip_pitch", "knee", "tarsus", "foot_crank", "plantar_rod", "foot",
)  # fmt: skip
"""Hinges of a leg whose angle is sought: springs are at rest, the ball follows from the others."""

ROLL, YAW, PITCH, KNEE, TARSUS, CRANK, PLANTAR, FOOT = range(len(JOINTS))

PARENTS = (-1, ROLL, YAW, PITCH, KNEE, TARSUS, CRANK, TARSUS)
"""Index of the hinge before each hinge; springs in between are rigid."""

MOTORS = (ROLL, YAW, PITCH, KNEE, FOOT)
"""Hinges with a motor, in motor order."""

CHAIN = (ROLL, YAW, PITCH, KNEE, TARSUS, FOOT)
"""Hinges from the pelvis to the sole."""


@dataclass(frozen=True)
class Frames:
    """Where the hinges of the legs are, pelvis frame."""

    rotation: list[np.ndarray]
    """Per hinge (n, 2, 3, 3), hinge to pelvis; the third column is its axis."""
    origin: list[np.ndarray]
    """Per hinge (n, 2, 3) [m]."""

    def point(self, joint: int, offset: np.ndarray) -> np.ndarray:
        """(n, 2, 3) pelvis-frame position of points (2, 3) fixed to the body after a hinge."""
        return self.origin[joint] + rotate(self.rotation[joint], offset)

    def axis(self, joint: int) -> np.ndarray:
        """(n, 2, 3) unit vector about which a hinge turns."""
        return self.rotation[joint][..., 2]


@dataclass(frozen=True)
class LegGeometry:
    """Constants of both legs; every array starts with the side axis (2, ...), left first."""

    rotation: np.ndarray
    """(2, 8, 3, 3) each hinge to its parent, at angle zero."""
    translation: np.ndarray
    """(2, 8, 3) each hinge in its parent's frame [m]."""
    lower: np.ndarray
    """(2, 8) lowest angles [rad]."""
    upper: np.ndarray
    """(2, 8) highest angles [rad]."""
    drawn: np.ndarray
    """(2, 8) angles in the pose that the MJCF draws, with the loops closed [rad]."""
    sole_rotation: np.ndarray
    """(2, 3, 3) sole to foot."""
    sole: np.ndarray
    """(2, 3) centre of the sole in the foot [m]."""
    ball_rotation: np.ndarray
    """(2, 3, 3) Achilles rod to hip pitch body, at rest."""
    ball: np.ndarray
    """(2, 3) ball joint of the Achilles rod in the hip pitch body [m]."""
    rod: np.ndarray
    """(2, 3) far end of the Achilles rod in its own frame [m]."""
    heel: np.ndarray
    """(2, 3) where the Achilles rod holds the tarsus (through the heel spring) [m]."""
    plantar_end: np.ndarray
    """(2, 3) far end of the plantar rod in its own frame [m]."""
    plantar_anchor: np.ndarray
    """(2, 3) where the plantar rod holds the foot [m]."""

    @classmethod
    def from_model(
        cls, model: pin.Model, loops: Sequence[pin.PointAnchorConstraintModel]
    ) -> LegGeometry:
        """Read placements, limits and loop closures."""
        sides = [_side_geometry(model, loops, side) for side in SIDES]
        return cls(**{name: _read_only([side[name] for side in sides]) for name in sides[0]})

    @property
    def rod_length(self) -> np.ndarray:
        """(2,) length of the Achilles rods [m]."""
        return np.linalg.norm(self.rod, axis=-1)

    def frames(self, angle: np.ndarray) -> Frames:
        """Forward kinematics of hinge angles (n, 2, 8) [rad]."""
        cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
        frames = Frames([], [])
        for joint, parent in enumerate(PARENTS):
            turn, shift = self.rotation[:, joint], self.translation[:, joint]
            if parent >= 0:
                shift = frames.point(parent, shift)
                turn = frames.rotation[parent] @ turn
            x, y, z = turn[..., 0], turn[..., 1], turn[..., 2]
            c, s = cos[..., joint, :], sin[..., joint, :]
            turned = (c * x + s * y, c * y - s * x, np.broadcast_to(z, np.shape(c * x)))
            frames.rotation.append(np.stack(turned, axis=-1))
            frames.origin.append(np.broadcast_to(shift, np.shape(c * x)))
        return frames

    def sole_frame(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Centre (n, 2, 3) [m] and rotation (n, 2, 3, 3) of the soles, sole to pelvis."""
        return frames.point(FOOT, self.sole), frames.rotation[FOOT] @ self.sole_rotation


def _side_geometry(
    model: pin.Model, loops: Sequence[pin.PointAnchorConstraintModel], side: Side
) -> dict[str, np.ndarray]:
    joint_ids = [model.getJointId(f"{side}_{name}") for name in JOINTS]
    parents = [model.getJointId("pelvis"), *joint_ids]
    placements = [
        _placement(model, joint, parents[parent + 1])
        for joint, parent in zip(joint_ids, PARENTS, strict=True)
    ]
    sole = model.frames[model.getFrameId(foot_site(side), pin.FrameType.OP_FRAME)].placement
    ball_id = model.getJointId(f"{side}_achilles_rod")
    ball = _placement(model, ball_id, joint_ids[PITCH])
    rod_end, heel_end = _loop(loops, ball_id)
    heel = _placement(model, heel_end.joint, joint_ids[TARSUS]).act(heel_end.point)
    plantar_end, plantar_anchor = _loop(loops, joint_ids[PLANTAR])
    index = [model.idx_qs[joint] for joint in joint_ids]
    return {
        "rotation": np.stack([placement.rotation for placement in placements]),
        "translation": np.stack([placement.translation for placement in placements]),
        "lower": model.lowerPositionLimit[index],
        "upper": model.upperPositionLimit[index],
        "drawn": model.referenceConfigurations[DRAWN][index],
        "sole_rotation": sole.rotation,
        "sole": sole.translation,
        "ball_rotation": ball.rotation,
        "ball": ball.translation,
        "rod": rod_end.point,
        "heel": heel,
        "plantar_end": plantar_end.point,
        "plantar_anchor": plantar_anchor.point,
    }


def _placement(model: pin.Model, joint: int, ancestor: int) -> pin.SE3:
    """Pose of a joint in an ancestor's frame with the joints in between at zero."""
    placement = pin.SE3.Identity()
    while joint != ancestor:
        placement = model.jointPlacements[joint] * placement
        joint = model.parents[joint]
    return placement


@dataclass(frozen=True)
class _LoopEnd:
    joint: int
    point: np.ndarray


def _loop(loops: Sequence[pin.PointAnchorConstraintModel], joint: int) -> tuple[_LoopEnd, _LoopEnd]:
    """Both ends of the loop that a rod closes, the rod's own first."""
    loop = next(loop for loop in loops if loop.joint1_id == joint)
    return (
        _LoopEnd(loop.joint1_id, np.array(loop.joint1_placement.translation)),
        _LoopEnd(loop.joint2_id, np.array(loop.joint2_placement.translation)),
    )


def _read_only(sides: list[np.ndarray]) -> np.ndarray:
    array = np.stack(sides)
    array.setflags(write=False)
    return array
