"""Tabulate motions: inverse kinematics and statics at every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aslip.errors import ConfigurationError
from aslip.ik import BodyTarget, IkSolution, Kinematics, solve, static_torque
from aslip.library.table import FEWEST_SAMPLES, GaitTable
from aslip.robot import CASSIE, Robot
from aslip.rom.arc import displacement
from aslip.rom.motion import PHASE_SAMPLES, Motion, MotionSample


def tabulate(
    motions: Sequence[Motion],
    robot: Robot = CASSIE,
    *,
    samples: int = PHASE_SAMPLES,
    torque_jumps: bool = False,
) -> GaitTable:
    """Tabulate motions whose commands form a grid, with the robot's configurations and torques.

    Inverse kinematics maps the body of the reduced-order model to the pelvis origin and its point
    feet to the centres of the soles. Toes point along the foot heading and soles are level along
    the toes; a leg without a motor for the roll of its foot lets the sole lean with it (0.04 rad
    for Cassie). Public code keeps the legs in vertical planes and the foot motors still, so that
    its feet tilt and sink into the floor. Statics turns the model's ground forces into motor
    torques.

    Args:
        motions: one motion per point of the grid, in ascending order of commands; the last axis of
            the command varies fastest.
        robot: robot that the motions are mapped to.
        samples: samples of a stride.
        torque_jumps: forces may jump between samples, see `GaitTable`.

    Raises:
        ConfigurationError: the commands do not form a grid, a stride is not finite, a motion turns,
            or there are fewer than four samples.
        UnreachablePoseError: the robot cannot take a pose of a motion.
    """
    if samples < FEWEST_SAMPLES:
        raise ConfigurationError(f"samples must be {FEWEST_SAMPLES} or more, got {samples!r}")
    axes = grid_axes(motions)
    kinematics, phase = Kinematics(robot), np.arange(samples) / samples
    rows = [_row(kinematics, motion, phase) for motion in motions]
    grid = tuple(map(len, axes))
    columns = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return GaitTable(
        axes=axes,
        torque_jumps=torque_jumps,
        robot=robot,
        **{name: column.reshape(*grid, *column.shape[1:]) for name, column in columns.items()},
    )


def grid_axes(motions: Sequence[Motion]) -> tuple[np.ndarray, ...]:
    """Values of the command along each axis of the grid that motions form.

    Raises:
        ConfigurationError: the commands do not form a grid in ascending order.
    """
    commands = [np.asarray(motion.command, dtype=float) for motion in motions]
    if commands and all(c.ndim == 1 and c.shape == commands[0].shape for c in commands):
        axes = tuple(np.unique(column) for column in np.transpose(commands))
        mesh = np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=1)
        if np.array_equal(mesh, commands):
            return axes
    raise ConfigurationError(
        "commands of motions must be ascending and form a grid, one motion per point, got"
        f" {[command.tolist() for command in commands]}"
    )


def _row(kinematics: Kinematics, motion: Motion, phase: np.ndarray) -> dict[str, np.ndarray]:
    """Rows of a table for one motion, by name of the array."""
    sample, uniform = motion.sample(phase), displacement(motion, phase).position
    _check_heading(motion)
    pose = _pose(kinematics, motion, sample)
    qpos = pose.qpos.copy()
    qpos[:, :3] -= uniform
    return {
        "strides": np.array(motion.stride),
        "body_position": sample.body.position - uniform,
        "body_velocity": sample.body.velocity,
        "foot_position": sample.feet.position - sample.body.position[:, None],
        "foot_velocity": sample.feet.velocity,
        "motor_position": pose.motor_position,
        "motor_velocity": pose.motor_velocity,
        "motor_torque": static_torque(kinematics, pose.qpos, sample.ground_force),
        "qpos": qpos,
        "qvel": pose.qvel,
    }


def _pose(kinematics: Kinematics, motion: Motion, sample: MotionSample) -> IkSolution:
    """Inverse kinematics at the samples of a stride."""
    # central differences over the closed stride, 0 for toes that do not turn
    toes = sample.foot_heading
    turn = np.roll(toes, -1, axis=0) - np.roll(toes, 1, axis=0)
    toe_rate = turn * len(toes) / (2 * motion.stride)
    targets = [
        BodyTarget(
            position,
            orientation=_about_vertical(angle),
            velocity=velocity,
            angular_velocity=np.multiply.outer(rate, [0.0, 0.0, 1.0]),
        )
        for position, velocity, angle, rate in (
            (sample.body.position, sample.body.velocity, sample.heading.angle, sample.heading.rate),
            *(
                (
                    sample.feet.position[:, i],
                    sample.feet.velocity[:, i],
                    sample.foot_heading[:, i],
                    toe_rate[:, i],
                )
                for i in range(2)
            ),
        )
    ]
    return solve(kinematics, *targets)


def _about_vertical(angle: np.ndarray) -> np.ndarray:
    """(m, 4) rotations about the vertical, wxyz."""
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)], axis=1)


def _check_heading(motion: Motion) -> None:
    start, end = motion.sample(np.array([0.0, 1.0])).heading.angle
    if not np.isclose(start, end, atol=1e-6):
        raise ConfigurationError(
            f"a motion must return to its heading after a stride to be tabulated; this one turns by"
            f" {end - start:.3g} rad a stride"
        )
