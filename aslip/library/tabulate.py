"""Motions -> inverse kinematics and statics -> one table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aslip.errors import ConfigurationError
from aslip.ik import BodyTarget, IkSolution, Kinematics, solve, static_torque
from aslip.library.table import FEWEST_SAMPLES, GaitTable
from aslip.rom.motion import PHASE_SAMPLES, Motion, MotionSample, displacement


def tabulate(
    motions: Sequence[Motion], *, samples: int = PHASE_SAMPLES, torque_jumps: bool = False
) -> GaitTable:
    """Put the robot on motions whose commands form a grid.

    The body of the reduced-order model is mapped to the pelvis origin and its point feet to the
    centres of the soles, at the model's lateral positions, toes along their heading and soles level
    along them; across, a sole leans with its leg (0.04 rad), for there is no motor for its roll.
    Public code keeps the legs in their vertical planes and the foot motors still, so that its feet
    tilt and sink into the floor. Forces of the model's legs act on the soles, too, and become
    torques.

    Args:
        motions: one motion per point of the grid, in ascending order of commands; the last axis of
            the command varies fastest.
        samples: samples of a stride m.
        torque_jumps: forces may jump between samples, see `GaitTable`.

    Raises:
        ConfigurationError: commands do not form such a grid; a stride is not finite; a body has
            turned after a stride; or samples fewer than four.
        UnreachablePoseError: the robot cannot take a pose of a motion.
    """
    if samples < FEWEST_SAMPLES:
        raise ConfigurationError(f"samples must be {FEWEST_SAMPLES} or more, got {samples!r}")
    axes = grid_axes(motions)
    kinematics, phase = Kinematics(), np.arange(samples) / samples
    rows = [_row(kinematics, motion, phase) for motion in motions]
    grid = tuple(map(len, axes))
    columns = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return GaitTable(
        axes=axes,
        torque_jumps=torque_jumps,
        **{name: column.reshape(*grid, *column.shape[1:]) for name, column in columns.items()},
    )


def grid_axes(motions: Sequence[Motion]) -> tuple[np.ndarray, ...]:
    """Values of the command along each axis of the grid that motions form.

    Raises:
        ConfigurationError: the commands, in order, are not those of a grid.
    """
    commands = [np.asarray(motion.command, dtype=float) for motion in motions]
    if commands and all(c.ndim == 1 and c.shape == commands[0].shape for c in commands):
        axes = tuple(np.unique(column) for column in np.transpose(commands))
        mesh = np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=1)
        if np.array_equal(mesh, commands):
            return axes
    raise ConfigurationError(
        "commands of motions must be ascending and form a grid, one motion per point; got"
        f" {[command.tolist() for command in commands]}"
    )


def _row(kinematics: Kinematics, motion: Motion, phase: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of a table for one motion, by name."""
    sample, uniform = motion.sample(phase), displacement(motion, phase)
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
    """The robot on the samples of a stride."""
    # toes: rate by central differences over the closed stride, 0 for toes that do not turn
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
            f"a motion must keep its mean heading to be tabulated; this one turns by"
            f" {end - start:.3g} rad a stride"
        )
