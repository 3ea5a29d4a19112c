"""Conversion between MuJoCo's and Drake's generalised positions and velocities.

Hinges differ by their zero, the angle at which the MJCF defines the bodies. The pelvis' position
follows its quaternion in Drake, and its angular velocity is in the world instead of the pelvis
frame. Ball joints have an angular velocity in the parent's frame, and roll, pitch and yaw instead
of a quaternion; the rods of the legs stay far from the singularity at a pitch of 90 degrees.
"""

# Drake's stubs give arrays a wrong shape
# pyright: reportArgumentType=false, reportCallIssue=false, reportMissingModuleSource=false

from __future__ import annotations

import math

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from aslip.robot import Robot


class Coordinates:
    """Indices of a robot's joints in MuJoCo's and in Drake's arrays.

    Args:
        plant: robot in Drake; joints have the names of their bodies.
        robot: robot of the plant.
    """

    def __init__(self, plant: MultibodyPlant, robot: Robot) -> None:
        self._num_q, self._num_v = plant.num_positions(), plant.num_velocities()
        joints = list(robot.skeleton.joints.values())
        starts = {
            joint.body: (place.position_start(), place.velocity_start())
            for joint in joints
            for place in [plant.GetJointByName(joint.body)]
        }
        hinges = [joint for joint in joints if joint.kind == "hinge"]
        self._zero = np.array([joint.zero for joint in hinges])
        self._qpos = np.array([joint.qpos for joint in hinges])
        self._qvel = np.array([joint.qvel for joint in hinges])
        self._q, self._v = np.array([starts[joint.body] for joint in hinges]).T
        self._balls = [(j.qpos, j.qvel, *starts[j.body]) for j in joints if j.kind == "ball"]
        self._free = starts[robot.pelvis]
        self._num_qpos, self._num_qvel = robot.indices.num_qpos, robot.indices.num_qvel

    def to_drake(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Convert `qpos` (35,) and `qvel` (32,) to Drake's positions and velocities, joined."""
        q, v = np.zeros(self._num_q), np.zeros(self._num_v)
        q[self._q], v[self._v] = qpos[self._qpos] - self._zero, qvel[self._qvel]
        start, speed = self._free
        unit = qpos[3:7] / np.linalg.norm(qpos[3:7])
        q[start : start + 7] = *unit, *qpos[:3]
        turn = RotationMatrix(Quaternion(unit)).matrix()
        v[speed : speed + 6] = *(turn @ qvel[3:6]), *qvel[:3]
        for at, rate, start, speed in self._balls:
            quaternion = qpos[at : at + 4] / np.linalg.norm(qpos[at : at + 4])
            rotation = RotationMatrix(Quaternion(quaternion))
            q[start : start + 3] = RollPitchYaw(rotation).vector()
            v[speed : speed + 3] = rotation.matrix() @ qvel[rate : rate + 3]
        return np.concatenate([q, v])

    def from_drake(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Convert Drake's positions and velocities, joined, to `qpos` (35,) and `qvel` (32,)."""
        q, v = state[: self._num_q], state[self._num_q :]
        qpos, qvel = np.empty(self._num_qpos), np.empty(self._num_qvel)
        qpos[self._qpos], qvel[self._qvel] = q[self._q] + self._zero, v[self._v]
        start, speed = self._free
        quaternion = q[start : start + 4]
        # Drake lets the quaternion's length drift, as only the direction counts
        unit = quaternion / math.sqrt(quaternion @ quaternion)
        qpos[:3], qpos[3:7] = q[start + 4 : start + 7], unit
        turn = RotationMatrix(Quaternion(unit)).matrix()
        qvel[:3], qvel[3:6] = v[speed + 3 : speed + 6], v[speed : speed + 3] @ turn
        for at, rate, start, speed in self._balls:
            rotation = RollPitchYaw(q[start : start + 3]).ToRotationMatrix()
            qpos[at : at + 4] = rotation.ToQuaternion().wxyz()
            qvel[rate : rate + 3] = v[speed : speed + 3] @ rotation.matrix()
        return qpos, qvel
