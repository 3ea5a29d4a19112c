"""Where bodies are and how joints stand, as logs have it."""

from __future__ import annotations

import mujoco
import numpy as np

from aslip.log.messages import LOGGED_JOINTS
from aslip.robot import CASSIE


class LoggedKinematics:
    """Poses of all bodies, and joints as viewers want them, from the state."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._xpos, self._xquat = self._data.xpos[1:], self._data.xquat[1:]
        self.bodies = [model.body(i).name for i in range(1, model.nbody)]
        joints = [model.joint(name) for name in LOGGED_JOINTS]
        passive = joints[len(CASSIE.motor_names) :]
        qpos = np.array([joint.qposadr[0] for joint in joints])
        qvel = np.array([joint.dofadr[0] for joint in joints])
        motors = np.arange(model.nu)
        # columns of `SimulatedEnv.watched`
        self._columns = np.concatenate([qpos, model.nq + qvel, model.nq + model.nv + motors])
        self._rest = model.qpos_spring[qpos[len(motors) :]]
        self._springs = np.array([[joint.stiffness[0], joint.damping[0]] for joint in passive]).T
        self.scale(1.0, 1.0)

    def scale(self, stiffness: float, damping: float) -> None:
        """Take springs and dampers for so many times as strong as the model's."""
        self._stiffness, self._damping = self._springs * [[stiffness], [damping]]

    def poses(self, qpos: np.ndarray, out: np.ndarray) -> None:
        """Put positions [m] and quaternions (xyzw) of all bodies but the world into (b, 7)."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        out[:, :3], out[:, 3:6], out[:, 6] = self._xpos, self._xquat[:, 1:], self._xquat[:, 0]

    def joints(self, rows: np.ndarray) -> np.ndarray:
        """Positions, velocities and efforts of `LOGGED_JOINTS`, from `qpos`, `qvel` and torques.

        Args:
            rows: (*b, 77 or more) as `SimulatedEnv.watched` has them.

        Returns:
            (*b, 48). The effort of a motor is its torque at the joint, of a spring what it and its
            damper exert [N m].
        """
        count, motors = len(LOGGED_JOINTS), self._model.nu
        values = rows[..., self._columns]
        angle, velocity = values[..., motors:count], values[..., count + motors : 2 * count]
        effort = self._stiffness * (self._rest - angle) - self._damping * velocity
        return np.concatenate([values, effort], axis=-1)
