"""Speeds -> optimal gaits -> inverse kinematics -> one library."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from aslip.errors import ConfigurationError
from aslip.ik import BodyTarget, IkSolution, Kinematics, solve, static_torque
from aslip.library.file import GaitTable
from aslip.library.grid import PAPER_SPEEDS, PHASE_SAMPLES
from aslip.rom import Gait, GaitSample, optimize_gaits


def build_library(
    speeds: Sequence[float] = PAPER_SPEEDS,
    *,
    samples: int = PHASE_SAMPLES,
    progress: Callable[[int, int, Gait], None] | None = None,
) -> tuple[list[Gait], GaitTable]:
    """Optimise all gaits and put the robot on them.

    The body of the reduced-order model is mapped to the pelvis origin and its point feet to the
    centres of the soles, at the model's lateral positions, toes forward and soles level along
    them; across, a sole leans with its leg (0.04 rad), for there is no motor for its roll. Public
    code keeps the legs in their vertical planes and the foot motors still, so that its feet tilt
    and sink into the floor. Forces of the model's legs act on the soles, too, and become torques.

    Args:
        speeds: ascending forward speeds [m/s].
        samples: samples of a stride m.
        progress: called with (index, count, gait) after each gait.

    Returns:
        The gaits, and their table for `GaitLibrary`.

    Raises:
        ConfigurationError: speeds do not ascend, or are fewer than two; or samples fewer than four.
        GaitOptimizationError: a gait was not found.
        UnreachablePoseError: the robot cannot take a pose of a gait.
    """
    if len(speeds) < 2 or any(b <= a for a, b in itertools.pairwise(speeds)):
        raise ConfigurationError(f"speeds must be two or more, ascending; got {list(speeds)} m/s")
    if samples < 4:  # of which cubic interpolation takes four
        raise ConfigurationError(f"samples must be 4 or more, got {samples!r}")
    gaits = optimize_gaits(speeds, progress=progress)
    phase = np.arange(samples) / samples
    motions = [gait.sample(phase) for gait in gaits]
    kinematics = Kinematics()
    poses = [_solve_stride(kinematics, motion) for motion in motions]
    torques = [
        static_torque(kinematics, pose.qpos, _ground_force(motion))
        for pose, motion in zip(poses, motions, strict=True)
    ]
    forward = [np.outer(phase * gait.stride * gait.speed, [1.0, 0.0, 0.0]) for gait in gaits]
    qpos = np.stack([pose.qpos for pose in poses])
    qpos[..., :3] -= np.stack(forward)
    table = GaitTable(
        speeds=np.array([gait.speed for gait in gaits]),
        strides=np.array([gait.stride for gait in gaits]),
        body_position=np.stack([m.body_position for m in motions]) - np.stack(forward),
        body_velocity=np.stack([m.body_velocity for m in motions]),
        left_foot_position=np.stack([m.left_foot_position - m.body_position for m in motions]),
        left_foot_velocity=np.stack([m.left_foot_velocity for m in motions]),
        right_foot_position=np.stack([m.right_foot_position - m.body_position for m in motions]),
        right_foot_velocity=np.stack([m.right_foot_velocity for m in motions]),
        motor_position=np.stack([pose.motor_position for pose in poses]),
        motor_velocity=np.stack([pose.motor_velocity for pose in poses]),
        motor_torque=np.stack(torques),
        qpos=qpos,
        qvel=np.stack([pose.qvel for pose in poses]),
    )
    return gaits, table


def _ground_force(motion: GaitSample) -> np.ndarray:
    """(m, 2, 3) force of the ground on the model's feet [N]."""
    feet = np.stack([motion.left_foot_position, motion.right_foot_position], axis=1)
    leg = motion.body_position[:, None] - feet
    return motion.leg_force[..., None] * leg / np.linalg.norm(leg, axis=-1, keepdims=True)


def _solve_stride(kinematics: Kinematics, motion: GaitSample) -> IkSolution:
    return solve(
        kinematics,
        BodyTarget(motion.body_position, velocity=motion.body_velocity),
        BodyTarget(motion.left_foot_position, velocity=motion.left_foot_velocity),
        BodyTarget(motion.right_foot_position, velocity=motion.right_foot_velocity),
    )
