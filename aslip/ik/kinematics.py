"""Cassie in Pinocchio, spoken to in MuJoCo's conventions.

Both read the same MJCF. They differ in the order of quaternions (Pinocchio: xyzw) and in the frame
of the free joint's linear velocity (Pinocchio: pelvis, MuJoCo: world). Hinge angles are equal, and
angular velocities are in the body's frame in both.
"""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from aslip.errors import ShapeError
from aslip.files.assets import asset_path
from aslip.ik.leg import JOINTS, LegGeometry
from aslip.ik.mjcf import read_mjcf
from aslip.ik.rotation import quaternion_to_matrix, rotate, rotate_back
from aslip.robot import MOTOR_NAMES, SIDES, Side, foot_site

PELVIS_POSITION = slice(0, 3)
PELVIS_ORIENTATION = slice(3, 7)
PELVIS_VELOCITY = slice(0, 3)
PELVIS_ANGULAR_VELOCITY = slice(3, 6)


@dataclass(frozen=True)
class ForwardKinematics:
    """Where the feet are in n configurations, world frame; left before right."""

    foot_position: np.ndarray
    """(n, 2, 3) centres of the soles [m]."""
    foot_rotation: np.ndarray
    """(n, 2, 3, 3) sole to world."""
    loop_gap: np.ndarray
    """(n, 4, 3) what each loop lacks to be closed [m], in the order of `CassieKinematics.loops`."""
    centre_of_mass: np.ndarray
    """(n, 3) [m]."""


class CassieKinematics:
    """Pinocchio's model of Cassie with its four loops.

    Attributes:
        model: the Pinocchio model.
        loops: its four point constraints.
        legs: geometry of both legs for the batched solver.
        lower_limit: (35,) lowest `qpos`; -inf where there is no limit.
        upper_limit: (35,) highest `qpos`.
        motor_q: (10,) where the motors are in `qpos`, in motor order.
        motor_v: (10,) the same in `qvel`.
        hinge_q: (2, 8) where the legs' hinges (`aslip.ik.leg.JOINTS`) are in `qpos`.
        hinge_v: (2, 8) the same in `qvel`.
        ball_q: (2, 4) where the Achilles rods' quaternions are in `qpos`.
        ball_v: (2, 3) where their angular velocities are in `qvel`.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Read an MJCF of Cassie, the one that ships with the package by default.

        Raises:
            AssetError: the shipped file is missing.
        """
        path = asset_path("cassie.xml") if path is None else path
        self.model, self.loops = read_mjcf(path)
        self._data = self.model.createData()
        self.legs = LegGeometry.from_model(self.model, self.loops)
        self._index_joints()
        self.lower_limit = self._limit(self.model.lowerPositionLimit, -np.inf)
        self.upper_limit = self._limit(self.model.upperPositionLimit, np.inf)

    def _index_joints(self) -> None:
        """Resolve every index once, by name."""
        q, v, width = (list(x) for x in (self.model.idx_qs, self.model.idx_vs, self.model.nqs))
        ids = {name: self.model.getJointId(name) for name in self.model.names}
        self._hinges = [q[joint] for joint in ids.values() if width[joint] == 1]
        self.motor_q = _frozen([q[ids[name]] for name in MOTOR_NAMES])
        self.motor_v = _frozen([v[ids[name]] for name in MOTOR_NAMES])
        hinges = [[ids[f"{side}_{joint}"] for joint in JOINTS] for side in SIDES]
        self.hinge_q = _frozen([[q[joint] for joint in leg] for leg in hinges])
        self.hinge_v = _frozen([[v[joint] for joint in leg] for leg in hinges])
        balls = [ids[f"{side}_achilles_rod"] for side in SIDES]
        self.ball_q = _frozen([q[ball] + np.arange(4) for ball in balls])
        self.ball_v = _frozen([v[ball] + np.arange(3) for ball in balls])
        self._wxyz_to_xyzw = np.arange(self.model.nq)
        for slots in (np.arange(self.model.nq)[PELVIS_ORIENTATION], *self.ball_q):
            self._wxyz_to_xyzw[slots] = np.roll(slots, -1)
        self._xyzw_to_wxyz = np.argsort(self._wxyz_to_xyzw)

    def _limit(self, limit: np.ndarray, unlimited: float) -> np.ndarray:
        """(35,) limits of the hinges; Pinocchio's bounds on quaternions are no limits."""
        result = np.full(self.model.nq, unlimited)
        result[self._hinges] = limit[self._hinges]
        result.setflags(write=False)
        return result

    def to_pinocchio(self, qpos: np.ndarray) -> np.ndarray:
        """Pinocchio's configuration (..., 35) of MuJoCo's `qpos` (..., 35)."""
        return qpos[..., self._wxyz_to_xyzw]

    def to_mujoco(self, configuration: np.ndarray) -> np.ndarray:
        """MuJoCo's `qpos` (..., 35) of Pinocchio's configuration (..., 35)."""
        return configuration[..., self._xyzw_to_wxyz]

    def velocity_to_pinocchio(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Pinocchio's velocity (..., 32) of MuJoCo's `qvel` (..., 32) at `qpos` (..., 35)."""
        velocity = np.array(qvel, dtype=np.float64)
        velocity[..., PELVIS_VELOCITY] = rotate_back(
            _pelvis_to_world(qpos), velocity[..., PELVIS_VELOCITY]
        )
        return velocity

    def velocity_to_mujoco(self, qpos: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """MuJoCo's `qvel` (..., 32) of Pinocchio's velocity (..., 32) at `qpos` (..., 35)."""
        qvel = np.array(velocity, dtype=np.float64)
        qvel[..., PELVIS_VELOCITY] = rotate(_pelvis_to_world(qpos), qvel[..., PELVIS_VELOCITY])
        return qvel

    def forward(self, qpos: np.ndarray) -> ForwardKinematics:
        """Feet, loops and centre of mass of configurations (n, 35), each evaluated by Pinocchio.

        Raises:
            ShapeError: `qpos` is not (n, 35).
        """
        feet, gaps, centres = [], [], []
        for configuration in self._configurations(qpos):
            centres.append(pin.centerOfMass(self.model, self._data, configuration).copy())
            feet.append([self._sole(side) for side in SIDES])
            gaps.append([self._gap(loop) for loop in self.loops])
        position, rotation = ([[foot[i] for foot in pair] for pair in feet] for i in range(2))
        return ForwardKinematics(
            foot_position=np.array(position).reshape(-1, len(SIDES), 3),
            foot_rotation=np.array(rotation).reshape(-1, len(SIDES), 3, 3),
            loop_gap=np.array(gaps).reshape(-1, len(self.loops), 3),
            centre_of_mass=np.array(centres).reshape(-1, 3),
        )

    def mass_matrix(self, qpos: np.ndarray) -> np.ndarray:
        """Joint-space inertia (n, 32, 32) with armature, for MuJoCo's `qvel`.

        Raises:
            ShapeError: `qpos` is not (n, 35).
        """
        matrices = []
        for configuration, pelvis_to_world in zip(
            self._configurations(qpos), _pelvis_to_world(qpos), strict=True
        ):
            matrix = pin.crba(self.model, self._data, configuration, pin.Convention.WORLD)
            # kinetic energy is the same in both conventions: v = S qvel, M_mujoco = S^T M S
            change = np.eye(self.model.nv)
            change[PELVIS_VELOCITY, PELVIS_VELOCITY] = pelvis_to_world.T
            full = np.triu(matrix) + np.triu(matrix, 1).T
            matrices.append(change.T @ full @ change)
        return np.array(matrices).reshape(-1, self.model.nv, self.model.nv)

    def _configurations(self, qpos: np.ndarray) -> np.ndarray:
        if np.ndim(qpos) != 2 or np.shape(qpos)[1] != self.model.nq:
            raise ShapeError(f"qpos must have shape (n, {self.model.nq}), got {np.shape(qpos)}")
        return self.to_pinocchio(qpos)

    def _sole(self, side: Side) -> tuple[np.ndarray, np.ndarray]:
        frame = self.model.getFrameId(foot_site(side), pin.FrameType.OP_FRAME)
        placement = pin.updateFramePlacement(self.model, self._data, frame)
        return placement.translation.copy(), placement.rotation.copy()

    def _gap(self, loop: pin.PointAnchorConstraintModel) -> np.ndarray:
        first, second = self._data.oMi[loop.joint1_id], self._data.oMi[loop.joint2_id]
        return first.act(loop.joint1_placement.translation) - second.act(
            loop.joint2_placement.translation
        )


def _pelvis_to_world(qpos: np.ndarray) -> np.ndarray:
    return quaternion_to_matrix(qpos[..., PELVIS_ORIENTATION])


def _frozen(indices: list) -> np.ndarray:
    array = np.array(indices)
    array.setflags(write=False)
    return array
