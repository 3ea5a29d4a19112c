"""Solve for configuration, velocity and motor angles from pelvis and foot targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aslip.errors import UnreachablePoseError
from aslip.ik.equations import POSITION, Equations, least_squares
from aslip.ik.kinematics import Kinematics
from aslip.ik.target import BodyMotion, BodyTarget, FootMotion
from aslip.robot import SIDES
from aslip.robot.rotation import quaternion_to_matrix, rotate_back

TOLERANCE: Final = 1e-13
"""Largest residual of a solved pose [m, rad]: rounding leaves a few 1e-16."""

MAX_ITERATIONS: Final = 20
"""Newton steps after which a pose is out of reach; poses of walking take four to six."""

MAX_STEP: Final = 0.8
"""Largest change of an angle in one step [rad]."""


@dataclass(frozen=True)
class IkResidual:
    """Largest errors over all poses of a solution."""

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
    """(n, nq)."""
    qvel: np.ndarray
    """(n, nv)."""
    motor_position: np.ndarray
    """(n, motors) [rad], motor order."""
    motor_velocity: np.ndarray
    """(n, motors) [rad/s], motor order."""
    residual: IkResidual


def solve(
    kinematics: Kinematics, pelvis: BodyTarget, left_foot: BodyTarget, right_foot: BodyTarget
) -> IkSolution:
    """Solve for configurations with the pelvis and both feet at their targets, springs at rest.

    Newton's method from the standing pose. A leg with five motors places the centre of the sole and
    points its toes, in yaw and pitch; the sole's roll about its toe axis follows from the lean of
    the leg. Velocities follow the targets' and keep the loops closed and the springs at rest. Loops
    are closed to rounding. Poses are independent: a pose gives the same bits in any batch.

    Args:
        kinematics: the robot.
        pelvis: n poses, world frame.
        left_foot: n poses of the centre of the left sole, world frame.
        right_foot: n poses of the centre of the right sole, world frame.

    Raises:
        UnreachablePoseError: a foot cannot get to its target within the joint limits.
        ShapeError: an array has the wrong shape.
    """
    base = BodyMotion.from_target("pelvis", pelvis)
    count = len(base.position)
    left = BodyMotion.from_target("left_foot", left_foot, count)
    right = BodyMotion.from_target("right_foot", right_foot, count)
    feet = FootMotion.relative(BodyMotion.stack(left, right), base)
    configuration, solved = newton(kinematics, feet)
    angle = configuration[:, kinematics.leg_q]
    inside = ((kinematics.lower <= angle) & (angle <= kinematics.upper)).all(-1)
    if not (solved & inside).all():
        pose, side = (int(i) for i in np.argwhere(~(solved & inside))[0])
        raise UnreachablePoseError(
            f"pose {pose}: the {SIDES[side]} foot cannot get to its target:"
            f" {_obstacle(kinematics, feet.take([pose]), configuration[[pose]], side)}"
        )
    equations = Equations.at(kinematics, configuration, feet)
    qpos, qvel = _whole_body(kinematics, base, configuration, _leg_velocity(equations, feet))
    return IkSolution(
        qpos=qpos,
        qvel=qvel,
        motor_position=qpos[:, kinematics.robot.indices.motor_qpos],
        motor_velocity=qvel[:, kinematics.robot.indices.motor_qvel],
        residual=_largest_residual(kinematics, equations),
    )


def newton(kinematics: Kinematics, feet: FootMotion) -> tuple[np.ndarray, np.ndarray]:
    """Solve the equations of both legs for all poses at once, without joint limits.

    Returns:
        Pinocchio's configurations (n, nq), pelvis at the origin, and a mask (n, 2) of solved legs.
    """
    count = len(feet.position)
    configuration = np.tile(kinematics.start, (count, 1))
    solved = np.zeros((count, 2), dtype=bool)
    left = np.arange(count)
    for iteration in range(MAX_ITERATIONS + 1):
        equations = Equations.at(kinematics, configuration[left], feet.take(left))
        solved[left] = equations.solved(TOLERANCE)
        open_ = ~solved[left].all(-1)
        left = left[open_]
        if not len(left) or iteration == MAX_ITERATIONS:
            break
        step = -least_squares(equations.jacobian[open_], equations.residual[open_][..., None])[
            ..., 0
        ]
        step *= MAX_STEP / np.maximum(np.abs(step).max(-1, keepdims=True), MAX_STEP)
        configuration[left] = kinematics.integrate(configuration[left], step)
    return configuration, solved


def _obstacle(
    kinematics: Kinematics, foot: FootMotion, configuration: np.ndarray, side: int
) -> str:
    """Reason why a leg does not reach the target of one pose: joint limits, or a distance."""
    equations = Equations.at(kinematics, configuration, foot)
    if not equations.solved(TOLERANCE)[0, side]:
        miss, turn = np.linalg.norm(equations.residual[0, side, POSITION]), equations.toe_angle()
        return f"Newton's method ends {miss:.4f} m and {turn[0, side]:.4f} rad away from it"
    legs = (kinematics.leg_joints, kinematics.leg_q, kinematics.lower, kinematics.upper)
    angles = zip(*(values[side] for values in legs), strict=True)
    return ", ".join(
        f"{name} would be at {angle:.4f} rad, and must be from {lower:.4f} to {upper:.4f} rad"
        for name, index, lower, upper in angles
        if not lower <= (angle := configuration[0, index]) <= upper
    )


def _leg_velocity(equations: Equations, feet: FootMotion) -> np.ndarray:
    """(n, 2, k) velocities that keep the residual at zero while the targets move."""
    drift = np.zeros((*equations.residual.shape, 1))
    drift[..., POSITION, 0] = feet.velocity
    drift[..., equations.direction, :] = equations.turn @ feet.angular_velocity[..., None]
    return least_squares(equations.jacobian, drift)[..., 0]


def _whole_body(
    kinematics: Kinematics, base: BodyMotion, configuration: np.ndarray, leg_velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`qpos` (n, nq) and `qvel` (n, nv) from a pelvis motion and the motion of the legs."""
    indices = kinematics.robot.indices
    qpos = kinematics.to_mujoco(configuration)
    qpos[:, indices.pelvis_position] = base.position
    qpos[:, indices.pelvis_orientation] = base.orientation
    qvel = np.zeros((len(qpos), indices.num_qvel))
    qvel[:, kinematics.leg_v] = leg_velocity
    qvel[:, indices.pelvis_velocity] = base.velocity
    qvel[:, indices.pelvis_angular_velocity] = rotate_back(
        quaternion_to_matrix(base.orientation), base.angular_velocity
    )
    return qpos, qvel


def _largest_residual(kinematics: Kinematics, equations: Equations) -> IkResidual:
    def largest(lengths: np.ndarray) -> float:
        return float(lengths.max(initial=0))

    return IkResidual(
        foot_position=largest(np.linalg.norm(equations.residual[..., POSITION], axis=-1)),
        toe_direction=largest(equations.toe_angle()),
        loop=largest(equations.loop_gap(kinematics)),
    )
