"""Pelvis and foot targets -> configuration, velocity and motor angles of Cassie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aslip.ik.equations import (
    ACHILLES,
    POSITION,
    TOES,
    Equations,
    achilles_rod,
    achilles_rod_rate,
    plantar_gap,
)
from aslip.ik.kinematics import (
    PELVIS_ANGULAR_VELOCITY,
    PELVIS_ORIENTATION,
    PELVIS_POSITION,
    PELVIS_VELOCITY,
    CassieKinematics,
)
from aslip.ik.newton import solve_legs
from aslip.ik.reach import check_reach
from aslip.ik.rotation import (
    cross,
    quaternion_to_matrix,
    rotate_back,
    shortest_rotation,
    shortest_rotation_rate,
)
from aslip.ik.target import BodyTarget, FootMotion, Motion


@dataclass(frozen=True)
class IkResidual:
    """The largest errors over all poses of a solution."""

    foot_position: float
    """Distance of a sole's centre from its target [m]."""
    toe_direction: float
    """Angle between a sole's x axis and its target's [rad]."""
    loop: float
    """Gap of a loop [m]."""


@dataclass(frozen=True)
class IkSolution:
    """Configurations of the robot at n instants, in MuJoCo's conventions."""

    qpos: np.ndarray
    """(n, 35)."""
    qvel: np.ndarray
    """(n, 32)."""
    motor_position: np.ndarray
    """(n, 10) [rad], motor order."""
    motor_velocity: np.ndarray
    """(n, 10) [rad/s], motor order."""
    sole_roll: np.ndarray
    """(n, 2) turn of each sole about its toe axis away from the target's [rad], left first."""
    residual: IkResidual
    iterations: int
    """Newton steps of the slowest leg."""


def solve(
    kinematics: CassieKinematics, pelvis: BodyTarget, left_foot: BodyTarget, right_foot: BodyTarget
) -> IkSolution:
    """Configurations with the pelvis and both feet where they are wanted, springs at rest.

    A leg has five motors: it places the centre of the sole and points its toes, in yaw and pitch.
    The sole's roll about its toe axis then follows from the lean of the leg, and is reported.
    Velocities follow the targets' and keep the loops closed and the springs at rest. Loops are
    closed to rounding. Each pose is solved on its own, bit for bit the same in any batch.

    Args:
        kinematics: the robot.
        pelvis: n poses, world frame.
        left_foot: n poses of the centre of the left sole, world frame.
        right_foot: the same for the right.

    Raises:
        UnreachablePoseError: a foot cannot get to its target within the joint limits.
        ShapeError: an array has the wrong shape.
    """
    base = Motion.from_target("pelvis", pelvis)
    count = len(base.position)
    left = Motion.from_target("left_foot", left_foot, count)
    right = Motion.from_target("right_foot", right_foot, count)
    feet = FootMotion.relative(Motion.stack(left, right), base)
    legs = solve_legs(kinematics.legs, feet.position, feet.rotation)
    check_reach(kinematics.legs, legs, feet)
    equations = Equations.at(kinematics.legs, legs.angle, feet.position, feet.rotation)
    qpos, qvel = _whole_body(kinematics, base, equations, _hinge_rate(equations, feet))
    return IkSolution(
        qpos=qpos,
        qvel=qvel,
        motor_position=qpos[:, kinematics.motor_q],
        motor_velocity=qvel[:, kinematics.motor_v],
        sole_roll=_sole_roll(equations),
        residual=_largest_residual(equations),
        iterations=legs.iterations,
    )


def _hinge_rate(equations: Equations, feet: FootMotion) -> np.ndarray:
    """(n, 2, 8) hinge rates [rad/s] that keep the residual at zero while the targets move."""
    drift = np.zeros_like(equations.residual)
    drift[..., POSITION] = feet.velocity
    toe_rate = cross(feet.angular_velocity, feet.rotation[..., 0])
    drift[..., TOES] = rotate_back(feet.rotation, toe_rate)[..., 1:]
    return np.linalg.solve(equations.jacobian(), drift[..., None])[..., 0]


def _whole_body(
    kinematics: CassieKinematics, base: Motion, equations: Equations, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`qpos` (n, 35) and `qvel` (n, 32) of a pelvis motion, hinge angles and hinge rates."""
    model, count = kinematics.model, len(rate)
    rod, rod_rate = _rod_motion(equations, rate)
    configuration, velocity = np.zeros((count, model.nq)), np.zeros((count, model.nv))
    configuration[:, kinematics.hinge_q] = equations.angle
    velocity[:, kinematics.hinge_v] = rate
    velocity[:, kinematics.ball_v] = rod_rate
    qpos = kinematics.to_mujoco(configuration)
    qpos[:, PELVIS_POSITION] = base.position
    qpos[:, PELVIS_ORIENTATION] = base.orientation
    qpos[:, kinematics.ball_q] = rod
    velocity[:, PELVIS_VELOCITY] = base.velocity
    velocity[:, PELVIS_ANGULAR_VELOCITY] = rotate_back(
        quaternion_to_matrix(base.orientation), base.angular_velocity
    )
    return qpos, velocity


def _rod_motion(equations: Equations, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion (n, 2, 4) and body-frame angular velocity (n, 2, 3) of the Achilles rods.

    Nothing fixes a rod's turn about itself: it is the one that is not twisted from rest.
    """
    legs, frames = equations.legs, equations.frames
    rest = np.broadcast_to(legs.rod / legs.rod_length[:, None], rate[..., :3].shape)
    rod = achilles_rod(legs, frames)
    quaternion = shortest_rotation(rest, rod)
    omega = shortest_rotation_rate(rest, rod, achilles_rod_rate(legs, frames, rate))
    return quaternion, rotate_back(quaternion_to_matrix(quaternion), omega)


def _sole_roll(equations: Equations) -> np.ndarray:
    _, sole_to_pelvis = equations.legs.sole_frame(equations.frames)
    target_to_pelvis = equations.target_rotation
    left = rotate_back(target_to_pelvis, sole_to_pelvis[..., 1])
    return np.arctan2(left[..., 2], left[..., 1])


def _largest_residual(equations: Equations) -> IkResidual:
    residual = equations.residual
    gaps = np.linalg.norm(plantar_gap(equations.legs, equations.frames), axis=-1)
    return IkResidual(
        foot_position=float(np.linalg.norm(residual[..., POSITION], axis=-1).max(initial=0)),
        toe_direction=float(equations.toe_angle().max(initial=0)),
        loop=float(np.maximum(gaps, np.abs(residual[..., ACHILLES])).max(initial=0)),
    )
