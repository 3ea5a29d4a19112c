"""True state of the robot as named quantities, from MuJoCo's arrays.

Arrays have any leading shape b. Both simulators publish the quantities under `("truth", ...)`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from aslip.base.arrays import Array
from aslip.robot import Indices
from aslip.robot.rotation import matrix_to_quaternion, rotate_inverse, upper_hemisphere


@dataclass(frozen=True)
class Snapshot:
    """Arrays of the simulator that determine the true state."""

    qpos: Array
    """(*b, 35) generalised positions; free joint first, quaternion wxyz."""
    qvel: Array
    """(*b, 32) generalised velocities; linear in the world, angular in the pelvis frame."""
    qacc: Array
    """(*b, 32) generalised accelerations, in the frames of `qvel`."""
    site_xpos: Array
    """(*b, 3, 3) positions of the sites in the world [m]."""
    site_xmat: Array
    """(*b, 3, 9) site-to-world rotations, row-major."""
    sensordata: Array
    """(*b, k) readings of MuJoCo's sensors."""
    ground_force: Array
    """(*b, 2, 3) force of the floor on each foot, mean over the last policy period [N, world]."""
    qfrc_actuator: Array
    """(*b, 32) torques of the motors at the joints, in the order of `qvel`."""
    motor_power: Array
    """(*b, 10) positive mechanical power of the motors, mean over the last policy period [W]."""
    largest_force: Array
    """(*b, 2) largest vertical force of the floor on each foot in a physics step of the last
    policy period [N]."""

    @classmethod
    def stack(cls, snapshots: list[Snapshot]) -> Snapshot:
        """Stack snapshots along a new first axis."""
        return cls(*(np.stack([getattr(s, f.name) for s in snapshots]) for f in fields(cls)))

    @classmethod
    def concatenate(cls, snapshots: list[Snapshot]) -> Snapshot:
        """Concatenate snapshots of arrays (n_i, ...) along the first axis; copies."""
        return cls(*(np.concatenate([getattr(s, f.name) for s in snapshots]) for f in fields(cls)))


class PeriodLoads:
    """Loads of n robots over a policy period, and right after a reset.

    Args:
        num: number of robots n.
        indices: places of the motors in MuJoCo's arrays.
    """

    def __init__(self, num: int, indices: Indices) -> None:
        self._motors = indices.motor_qvel
        self.ground_force = np.zeros((num, 2, 3))
        """See `Snapshot.ground_force`; a sum until `average`."""
        self.motor_power = np.zeros((num, len(self._motors)))
        """See `Snapshot.motor_power`; braking motors count as zero."""
        self.largest_force = np.zeros((num, 2))
        """See `Snapshot.largest_force`."""

    def reset(self, ids: np.ndarray | slice, force: np.ndarray) -> None:
        """Take the forces (k, 2, 3) of (k,) robots at rest; their motors do no work."""
        self.ground_force[ids], self.largest_force[ids] = force, force[..., 2]
        self.motor_power[ids] = 0.0

    def clear(self) -> None:
        """Start a policy period."""
        for array in (self.ground_force, self.motor_power, self.largest_force):
            array[:] = 0.0

    def add(self, force: np.ndarray, torque: np.ndarray, qvel: np.ndarray) -> None:
        """Add a physics step.

        Args:
            force: (n, 2, 3) forces of the floor on the feet [N, world].
            torque: (n, 32) torques of the motors at the joints, in the order of `qvel` [N m].
            qvel: (n, 32) generalised velocities.
        """
        self.ground_force += force
        np.maximum(self.largest_force, force[..., 2], out=self.largest_force)
        self.motor_power += np.maximum(torque[:, self._motors] * qvel[:, self._motors], 0.0)

    def average(self, steps: float) -> None:
        """Divide sums by the number of physics steps."""
        self.ground_force /= steps
        self.motor_power /= steps


def true_state(snapshot: Snapshot, indices: Indices) -> dict[str, Array]:
    """Compute the named quantities of the true state.

    Args:
        snapshot: arrays of leading shape b.
        indices: places of the robot's parts in the arrays.

    Returns:
        `qpos` 35, `qvel` 32; `pelvis_position` 3 [m, world], `pelvis_orientation` 4 (wxyz, w >= 0),
        `pelvis_velocity` 3 [m/s, world], `pelvis_angular_velocity` 3 [rad/s, pelvis],
        `pelvis_acceleration` 3 [m/s^2, pelvis, gravity removed]; `motor_position` 10,
        `motor_velocity` 10, `joint_position` 6, `joint_velocity` 6 [rad, rad/s]; `motor_torque` 10
        [N m, at the joint, after limits and delay]; `motor_power` 10 [W, positive mechanical power,
        mean over the last policy period]; for `left_foot` and `right_foot` the sole centre's
        `_position` 3 [m, world], `_velocity` 3 [m/s, world] and `_orientation` 4 (wxyz, w >= 0;
        identity when level with toes along x); `ground_force` 2 x 3 [N, world], mean over the last
        policy period; `largest_force` 2 [N], largest vertical force on each foot in a physics step
        of that period.

        Accelerations, torques and forces belong to the start of the last substep, 0.5 ms before the
        state.
    """
    qpos, qvel, sensors = snapshot.qpos, snapshot.qvel, snapshot.sensordata
    orientation = upper_hemisphere(qpos[..., indices.pelvis_orientation])
    state = {
        "qpos": qpos,
        "qvel": qvel,
        "pelvis_position": qpos[..., indices.pelvis_position],
        "pelvis_orientation": orientation,
        "pelvis_velocity": qvel[..., indices.pelvis_velocity],
        "pelvis_angular_velocity": qvel[..., indices.pelvis_angular_velocity],
        # reading of an ideal accelerometer at the pelvis' origin, minus gravity
        "pelvis_acceleration": rotate_inverse(
            orientation, snapshot.qacc[..., indices.pelvis_velocity]
        ),
        "motor_position": qpos[..., indices.motor_qpos],
        "motor_velocity": qvel[..., indices.motor_qvel],
        "joint_position": qpos[..., indices.joint_qpos],
        "joint_velocity": qvel[..., indices.joint_qvel],
        "motor_torque": snapshot.qfrc_actuator[..., indices.motor_qvel],
        "motor_power": snapshot.motor_power,
        "ground_force": snapshot.ground_force,
        "largest_force": snapshot.largest_force,
    }
    for i, foot in enumerate(("left_foot", "right_foot")):
        site = indices.foot_site[i]
        state[f"{foot}_position"] = snapshot.site_xpos[..., site, :]
        state[f"{foot}_velocity"] = sensors[..., indices.foot_velocity[i]]
        state[f"{foot}_orientation"] = matrix_to_quaternion(
            snapshot.site_xmat[..., site, :].reshape(*snapshot.site_xmat.shape[:-2], 3, 3)
        )
    return state
