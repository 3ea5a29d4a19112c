"""Rows of a table for one motion: moving frame, inverse kinematics, statics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aslip.errors import ConfigurationError, UnreachablePoseError
from aslip.ik import (
    BodyTarget,
    IkSolution,
    Kinematics,
    leg_torque,
    pelvis_axes,
    share_friction,
    solve,
    static_torque,
)
from aslip.library.interpolation import open_slopes, periodic_slopes
from aslip.rom.arc import Pose
from aslip.rom.motion import Angle, Motion, MotionSample, Track, displacement

Rows = dict[str, np.ndarray]
"""Rows of one motion by name of the table's array."""

_INSTANT: Final = 1e-5  # difference of phase for the rate of the toes
_CLOSED: Final = 1e-6  # largest gap between a stride's end and the next one's start [m, rad]


@dataclass(frozen=True, eq=False)
class FramedMotion:
    """Motion sampled over a stride, in the axes of its moving frame.

    The frame starts as that of the motion at phase 0 and moves at the commanded twist. Positions
    are relative to the frame's origin at phase 0, velocities and rates are over ground.
    """

    command: np.ndarray
    """(c,) command of the motion."""
    stride: float
    """Duration of a stride [s]."""
    sample: MotionSample
    """Samples at m phases."""
    origin: np.ndarray
    """(m, 3) origin of the moving frame [m]."""
    toe_rate: np.ndarray
    """(m, 2) yaw rate of the toes [rad/s]."""
    period: float
    """Time between samples [s]."""
    repeats: bool
    """True if the first sample follows the last one."""

    @classmethod
    def of(cls, motion: Motion, phase: np.ndarray) -> FramedMotion:
        """Sample a motion at phases (m,).

        Raises:
            ConfigurationError: a stride does not end where the command leads, or its duration is
                not positive and finite.
        """
        path, sample = displacement(motion, phase), motion.sample(phase)
        axes = Pose(np.zeros_like(path.position), -path.angle)
        around = motion.sample(np.concatenate([phase + _INSTANT, phase - _INSTANT, (0.0, 1.0)]))
        _check_closed(motion, around)
        after, before = around.foot_heading[:-2].reshape(2, len(phase), 2)
        return cls(
            command=np.array(motion.command, dtype=float),
            stride=float(motion.stride),
            sample=_take(sample, slice(None)).moved(axes),
            origin=axes.rotate(path.position),
            toe_rate=(after - before) / (2 * _INSTANT * motion.stride),
            period=float(motion.stride) / len(phase),
            repeats=True,
        )

    @classmethod
    def still(cls, motion: Motion, phase: np.ndarray) -> FramedMotion:
        """Sample at phases (m,) a motion of zero command whose feet do not turn.

        The motion need not be periodic.
        """
        return cls(
            command=np.array(motion.command, dtype=float),
            stride=float(motion.stride),
            sample=motion.sample(phase),
            origin=np.zeros((len(phase), 3)),
            toe_rate=np.zeros((len(phase), 2)),
            period=float(motion.stride) / (len(phase) - 1),
            repeats=False,
        )

    def sharing_friction(self) -> FramedMotion:
        """The motion with ground forces of `aslip.ik.share_friction`."""
        force = share_friction(self.sample.ground_force)
        return replace(self, sample=replace(self.sample, ground_force=force))

    def rows(self, kinematics: Kinematics, *, leg_dynamics: bool = False) -> Rows:
        """Solve for the robot's configurations and torques.

        Args:
            kinematics: the robot.
            leg_dynamics: see `aslip.library.tabulate`.

        Raises:
            UnreachablePoseError: the robot cannot take a pose of the motion.
        """
        try:
            pose = self._pose(kinematics)
        except UnreachablePoseError as error:
            raise UnreachablePoseError(f"motion of command {self.command}: {error}") from error
        sample, qpos = self.sample, pose.qpos.copy()
        qpos[:, :3] -= self.origin
        torque = static_torque(kinematics, pose.qpos, sample.ground_force)
        if leg_dynamics:
            torque = torque + self._leg_torque(kinematics, pose)
        return {
            "strides": np.array(self.stride),
            "body_position": sample.body.position - self.origin,
            "body_velocity": sample.body.velocity,
            "body_heading": sample.heading.angle,
            "foot_position": sample.feet.position - sample.body.position[:, None],
            "foot_velocity": sample.feet.velocity,
            "foot_heading": sample.foot_heading,
            "motor_position": pose.motor_position,
            "motor_velocity": pose.motor_velocity,
            "motor_torque": torque,
            "qpos": qpos,
            "qvel": pose.qvel,
        }

    def _leg_torque(self, kinematics: Kinematics, pose: IkSolution) -> np.ndarray:
        """Torques that carry and accelerate the legs, with accelerations of splines."""
        velocity = pelvis_axes(kinematics, pose.qpos, pose.qvel)
        slopes = periodic_slopes if self.repeats else open_slopes
        acceleration = slopes(velocity[None])[0] / self.period
        return leg_torque(kinematics, pose.qpos, velocity, acceleration)

    def _pose(self, kinematics: Kinematics) -> IkSolution:
        """Inverse kinematics at the samples."""
        s = self.sample
        feet = [
            _target(
                s.feet.position[:, i],
                s.feet.velocity[:, i],
                s.foot_heading[:, i],
                self.toe_rate[:, i],
            )
            for i in range(2)
        ]
        pelvis = _target(s.body.position, s.body.velocity, s.heading.angle, s.heading.rate)
        return solve(kinematics, pelvis, *feet)


def _target(
    position: np.ndarray, velocity: np.ndarray, heading: np.ndarray, rate: np.ndarray
) -> BodyTarget:
    """Level body that turns about the vertical."""
    zero = np.zeros_like(heading)
    return BodyTarget(
        position,
        orientation=np.stack([np.cos(heading / 2), zero, zero, np.sin(heading / 2)], axis=1),
        velocity=velocity,
        angular_velocity=np.multiply.outer(rate, [0.0, 0.0, 1.0]),
    )


def _take(sample: MotionSample, rows: slice) -> MotionSample:
    """Select instants, as a plain `MotionSample`."""
    return MotionSample(
        body=Track(sample.body.position[rows], sample.body.velocity[rows]),
        feet=Track(sample.feet.position[rows], sample.feet.velocity[rows]),
        ground_force=sample.ground_force[rows],
        heading=Angle(sample.heading.angle[rows], sample.heading.rate[rows]),
        foot_heading=sample.foot_heading[rows],
    )


def _check_closed(motion: Motion, sample: MotionSample) -> None:
    """Check that the last two samples, start and end of a stride, differ by the command alone.

    Raises:
        ConfigurationError: they do not.
    """
    stride = displacement(motion, np.array([0.0, 1.0]))
    back = _take(sample, slice(-2, None)).moved(stride.inverse())
    turned = np.diff(sample.heading.angle[-2:]).item()
    angles = np.column_stack([back.heading.angle, back.foot_heading])
    if np.abs(np.diff(angles, axis=0)).max() > _CLOSED:
        raise ConfigurationError(
            "body and toes of a motion must turn by yaw rate times stride,"
            f" {stride.angle[1]:.3g} rad; this one turns by {turned:.3g} rad a stride"
        )
    points = np.concatenate([back.body.position[:, None], back.feet.position], axis=1)
    gap = np.linalg.norm(np.diff(points, axis=0), axis=-1).max()
    if gap > _CLOSED:
        raise ConfigurationError(
            f"a motion of command {np.asarray(motion.command).tolist()} and stride"
            f" {motion.stride:.4g} s must repeat, moved by the command, after a stride; this one"
            f" misses its start by {gap:.3g} m"
        )
