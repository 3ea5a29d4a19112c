"""The robot's true state in the vocabulary of walking, from MuJoCo's arrays.

One function serves one simulation and thousands: arrays have any leading shape b. It is what both
environment backends publish under `("truth", ...)`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from aslip.robot.model import CassieIndices


@dataclass(frozen=True)
class Snapshot:
    """What must be read from the simulator to know the true state."""

    qpos: np.ndarray
    """(*b, 35) generalised positions; free joint first, quaternion wxyz."""
    qvel: np.ndarray
    """(*b, 32) generalised velocities; linear in the world, angular in the pelvis frame."""
    qacc: np.ndarray
    """(*b, 32) accelerations, as `qvel`."""
    site_xpos: np.ndarray
    """(*b, 3, 3) positions of the sites in the world [m]."""
    site_xmat: np.ndarray
    """(*b, 3, 9) orientations of the sites, row-major site-to-world rotations."""
    sensordata: np.ndarray
    """(*b, k) all sensors."""
    ground_force: np.ndarray
    """(*b, 2, 3) force of the floor on each foot, mean over the last policy period [N, world]."""
    qfrc_actuator: np.ndarray
    """(*b, 32) torques of the motors at the joints, as `qvel`."""

    @classmethod
    def stack(cls, snapshots: list[Snapshot]) -> Snapshot:
        """Join snapshots along a new first axis."""
        return cls(*(np.stack([getattr(s, f.name) for s in snapshots]) for f in fields(cls)))

    @classmethod
    def concatenate(cls, snapshots: list[Snapshot]) -> Snapshot:
        """Join snapshots of (n_i, ...) arrays along their first axis; copies."""
        return cls(*(np.concatenate([getattr(s, f.name) for s in snapshots]) for f in fields(cls)))


def true_state(snapshot: Snapshot, indices: CassieIndices) -> dict[str, np.ndarray]:
    """Named quantities of the true state; frames are in the names.

    Args:
        snapshot: arrays of leading shape b.
        indices: where the robot's parts are in them.

    Returns:
        `qpos` 35, `qvel` 32; `pelvis_position` 3 [m, world], `pelvis_orientation` 4 (wxyz, w >= 0),
        `pelvis_velocity` 3 [m/s, world], `pelvis_angular_velocity` 3 [rad/s, pelvis],
        `pelvis_acceleration` 3 [m/s^2, pelvis, gravity removed]; `motor_position` 10,
        `motor_velocity` 10, `joint_position` 6, `joint_velocity` 6 [rad, rad/s]; `motor_torque` 10
        [N m, at the joint, after limits and delay]; for `left_foot`
        and `right_foot` the sole centre's `_position` 3 [m, world], `_velocity` 3 [m/s, world] and
        `_orientation` 4 (wxyz, w >= 0; identity when level with toes along x); `ground_force` 2 x 3
        [N, world], mean over the last policy period.

        Accelerations, torques and forces are those of the last substep's start, 0.5 ms before the
        state.
    """
    qpos, qvel, sensors = snapshot.qpos, snapshot.qvel, snapshot.sensordata
    orientation = upper_hemisphere(qpos[..., 3:7])
    state = {
        "qpos": qpos,
        "qvel": qvel,
        "pelvis_position": qpos[..., :3],
        "pelvis_orientation": orientation,
        "pelvis_velocity": qvel[..., :3],
        "pelvis_angular_velocity": qvel[..., 3:6],
        # what an accelerometer at the pelvis' origin reads, less gravity
        "pelvis_acceleration": rotate_inverse(orientation, snapshot.qacc[..., :3]),
        "motor_position": qpos[..., indices.motor_qpos],
        "motor_velocity": qvel[..., indices.motor_qvel],
        "joint_position": qpos[..., indices.joint_qpos],
        "joint_velocity": qvel[..., indices.joint_qvel],
        "motor_torque": snapshot.qfrc_actuator[..., indices.motor_qvel],
        "ground_force": snapshot.ground_force,
    }
    for i, foot in enumerate(("left_foot", "right_foot")):
        site = indices.foot_site[i]
        state[f"{foot}_position"] = snapshot.site_xpos[..., site, :]
        state[f"{foot}_velocity"] = sensors[..., indices.foot_velocity[i]]
        state[f"{foot}_orientation"] = quaternion_from_matrix(snapshot.site_xmat[..., site, :])
    return state


def upper_hemisphere(quaternion: np.ndarray) -> np.ndarray:
    """The same rotation with w >= 0; (*b, 4) wxyz."""
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def rotate_inverse(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Express a world vector in the frame whose frame-to-world rotation is given.

    Args:
        quaternion: (*b, 4) wxyz, unit.
        vector: (3,) or (*b, 3).

    Returns:
        (*b, 3).
    """
    w, u = quaternion[..., :1], -quaternion[..., 1:]
    t = 2.0 * np.cross(u, vector)
    return vector + w * t + np.cross(u, t)


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternion of a rotation.

    Built from the largest of the four candidates of each component, so it is accurate everywhere.

    Args:
        matrix: (*b, 9), row-major.

    Returns:
        (*b, 4) wxyz with w >= 0.
    """
    m = np.moveaxis(matrix.reshape(*matrix.shape[:-1], 3, 3), (-2, -1), (0, 1))
    # 4 q q^T, symmetric: the row with the largest diagonal entry is the best conditioned
    outer = np.empty((*matrix.shape[:-1], 4, 4))
    outer[..., 0, 0] = 1 + m[0, 0] + m[1, 1] + m[2, 2]
    outer[..., 1, 1] = 1 + m[0, 0] - m[1, 1] - m[2, 2]
    outer[..., 2, 2] = 1 - m[0, 0] + m[1, 1] - m[2, 2]
    outer[..., 3, 3] = 1 - m[0, 0] - m[1, 1] + m[2, 2]
    outer[..., 0, 1] = outer[..., 1, 0] = m[2, 1] - m[1, 2]
    outer[..., 0, 2] = outer[..., 2, 0] = m[0, 2] - m[2, 0]
    outer[..., 0, 3] = outer[..., 3, 0] = m[1, 0] - m[0, 1]
    outer[..., 1, 2] = outer[..., 2, 1] = m[0, 1] + m[1, 0]
    outer[..., 1, 3] = outer[..., 3, 1] = m[0, 2] + m[2, 0]
    outer[..., 2, 3] = outer[..., 3, 2] = m[1, 2] + m[2, 1]
    best = np.diagonal(outer, axis1=-2, axis2=-1).argmax(-1)
    row = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    return upper_hemisphere(row / np.linalg.norm(row, axis=-1, keepdims=True))
