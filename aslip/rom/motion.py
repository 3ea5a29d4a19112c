"""Motions: the output of any reduced-order model or planner, sampled by phase.

A motion is any object with a command, a stride and `sample`; it needs no base class:

    class Shuffle:
        command = np.array([0.3])      # forward speed [m/s]
        stride = 0.8                   # [s]

        def sample(self, phase: np.ndarray) -> MotionSample: ...

Frame of all samples: the ground below the body's mean path, x along the heading at phase 0, y left,
z up, ground at z = 0. The mean path is an arc of constant twist, straight without a yaw rate.
Motions go on from stride to stride: phase 1.25 is phase 0.25 one stride further along the path,
turned by yaw rate times stride.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from aslip.errors import ConfigurationError, FileDamagedError, ShapeError
from aslip.rom.arc import Pose, twist_pose

COMMAND_SIZES = (1, 2, 3)
"""Lengths of a command: forward speed, sideways speed [m/s], yaw rate [rad/s], in this order."""
PHASE_SAMPLES = 128
"""Samples of a stride in a table: one every 6 ms, five per policy step."""


@dataclass(frozen=True, eq=False)
class Track:
    """Positions and velocities of moving points, of equal shape: (m, 3) for the body."""

    position: np.ndarray
    """(..., 3) [m]."""
    velocity: np.ndarray
    """(..., 3) time derivative of the position [m/s]."""

    def moved(self, pose: Pose) -> Track:
        """Transform a track (m, ..., 3) from the frames of m poses to their common frame."""
        return Track(pose.transform(self.position), pose.rotate(self.velocity))

    def interpolated(self, knots: np.ndarray, at: np.ndarray) -> Track:
        """Cubic through points (n, ...) at increasing knots (n,), evaluated at (m,) of these."""
        # the import takes 0.3 s, and loading a library does not need it
        from scipy.interpolate import CubicHermiteSpline

        spline = CubicHermiteSpline(knots, self.position, self.velocity)
        return Track(spline(at), spline(at, 1))


@dataclass(frozen=True, eq=False)
class Angle:
    """Angle about the vertical at m instants."""

    angle: np.ndarray
    """(m,) [rad]."""
    rate: np.ndarray
    """(m,) time derivative of the angle [rad/s]."""

    @classmethod
    def zeros(cls, count: int) -> Angle:
        """Zero angle at every instant."""
        return cls(np.zeros(count), np.zeros(count))


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionSample:
    """Motion sampled at m phases; left before right on every foot axis.

    Raises:
        ShapeError: an array has the wrong shape, or non-finite entries.
    """

    body: Track
    """(m, 3) point body, mapped to the origin of the pelvis."""
    feet: Track
    """(m, 2, 3) point feet, mapped to the centres of the soles."""
    ground_force: np.ndarray
    """(m, 2, 3) force of the ground on each foot [N], 0 in swing."""
    heading: Angle
    """(m,) heading of the body, measured from the x axis."""
    foot_heading: np.ndarray
    """(m, 2) direction of the toes, measured from the x axis [rad]."""

    def __post_init__(self) -> None:
        """Check shapes."""
        m = len(self.body.position)
        for name, array, shape in (
            ("body.position", self.body.position, (m, 3)),
            ("body.velocity", self.body.velocity, (m, 3)),
            ("feet.position", self.feet.position, (m, 2, 3)),
            ("feet.velocity", self.feet.velocity, (m, 2, 3)),
            ("ground_force", self.ground_force, (m, 2, 3)),
            ("heading.angle", self.heading.angle, (m,)),
            ("heading.rate", self.heading.rate, (m,)),
            ("foot_heading", self.foot_heading, (m, 2)),
        ):
            if np.shape(array) != shape or not np.isfinite(array).all():
                raise ShapeError(
                    f"{name} of a motion must have shape {shape} and finite entries, got"
                    f" {np.shape(array)}"
                )

    def moved(self, pose: Pose) -> Self:
        """Transform the motion from the frames of m poses to their common frame."""
        return replace(
            self,
            body=self.body.moved(pose),
            feet=self.feet.moved(pose),
            ground_force=pose.rotate(self.ground_force),
            heading=Angle(self.heading.angle + pose.angle, self.heading.rate),
            foot_heading=self.foot_heading + pose.angle[:, None],
        )


class Motion(Protocol):
    """Periodic motion of a body and two feet: a gait, a recorded walk, a plan."""

    @property
    def command(self) -> np.ndarray:
        """(c,) command that the motion obeys, c = 1, 2 or 3.

        Mean forward speed [m/s], sideways speed [m/s], yaw rate [rad/s]; numbers left out are 0.
        """
        ...

    @property
    def stride(self) -> float:
        """Duration of a stride [s]; infinite for standing."""
        ...

    def sample(self, phase: np.ndarray, /) -> MotionSample:
        """Motion at phases (m,); 0 is left lift-off."""
        ...


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """Motion given by samples at equal steps of phase, such as a recorded walk.

    Between samples, positions are cubics that match the velocities, so that a stance foot stays at
    rest; forces and toe directions are linear.

    Raises:
        ConfigurationError: fewer than two samples, or a stride that is not positive and finite.
    """

    command: np.ndarray
    """(c,) as in `Motion`."""
    stride: float
    """Duration of a stride [s]."""
    samples: MotionSample
    """Samples at phases k / m, k = 0 ... m - 1."""

    def __post_init__(self) -> None:
        """Check stride and number of samples."""
        if not 0 < self.stride < np.inf or len(self.samples.foot_heading) < 2:
            raise ConfigurationError(
                "a sampled motion needs two or more samples and a positive, finite stride, got"
                f" {len(self.samples.foot_heading)} samples and a stride of {self.stride} s"
            )

    @classmethod
    def from_motion(cls, motion: Motion, samples: int = PHASE_SAMPLES) -> SampledMotion:
        """Motion sampled at equal steps of phase."""
        sample = motion.sample(np.arange(samples) / samples)
        return cls(np.array(motion.command, dtype=float), float(motion.stride), sample)

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Motion at phases (m,), 0 at left lift-off.

        Raises:
            ShapeError: phase is not one-dimensional, or not finite.
        """
        strides, within = split_phase(phase)
        s, next_stride = self.samples, self._next_stride()
        heading, end = (Track(one.angle, one.rate) for one in (s.heading, next_stride.heading))
        heading = self._track(heading, end, within)
        sample = MotionSample(
            body=self._track(s.body, next_stride.body, within),
            feet=self._track(s.feet, next_stride.feet, within),
            ground_force=_linear(s.ground_force, next_stride.ground_force, within),
            heading=Angle(heading.position, heading.velocity),
            foot_heading=_linear(s.foot_heading, next_stride.foot_heading, within),
        )
        return sample.moved(displacement(self, strides))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """All numbers as named arrays."""
        s = self.samples
        return {
            "command": np.array(self.command),
            "stride": np.array(self.stride),
            "body_position": s.body.position,
            "body_velocity": s.body.velocity,
            "foot_position": s.feet.position,
            "foot_velocity": s.feet.velocity,
            "ground_force": s.ground_force,
            "heading": s.heading.angle,
            "heading_rate": s.heading.rate,
            "foot_heading": s.foot_heading,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> SampledMotion:
        """Motion from the arrays of `to_arrays`, bit for bit.

        Raises:
            FileDamagedError: an array is missing.
        """
        try:
            samples = MotionSample(
                body=Track(arrays["body_position"], arrays["body_velocity"]),
                feet=Track(arrays["foot_position"], arrays["foot_velocity"]),
                ground_force=arrays["ground_force"],
                heading=Angle(arrays["heading"], arrays["heading_rate"]),
                foot_heading=arrays["foot_heading"],
            )
            return cls(arrays["command"], float(arrays["stride"]), samples)
        except KeyError as error:
            raise FileDamagedError(f"a motion needs {error}; got {sorted(arrays)}") from error

    def _next_stride(self) -> MotionSample:
        """First sample of the next stride."""
        s = self.samples
        first = MotionSample(
            body=Track(s.body.position[:1], s.body.velocity[:1]),
            feet=Track(s.feet.position[:1], s.feet.velocity[:1]),
            ground_force=s.ground_force[:1],
            heading=Angle(s.heading.angle[:1], s.heading.rate[:1]),
            foot_heading=s.foot_heading[:1],
        )
        return first.moved(displacement(self, np.ones(1)))

    def _track(self, track: Track, end: Track, within: np.ndarray) -> Track:
        """Cubic over phase through m samples and the first one of the next stride."""
        rates = self.stride * np.concatenate([track.velocity, end.velocity])
        path = Track(np.concatenate([track.position, end.position]), rates)
        found = path.interpolated(np.linspace(0.0, 1.0, len(rates)), within)
        return Track(found.position, found.velocity / self.stride)


def split_phase(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split phases (m,) into whole strides and phases within a stride.

    Raises:
        ShapeError: phase is not one-dimensional, or not finite.
    """
    phase = np.asarray(phase, dtype=float)
    if phase.ndim != 1 or not np.isfinite(phase).all():
        raise ShapeError(f"phase must be (m,) and finite, got shape {phase.shape}")
    strides = np.floor(phase)
    return strides, phase - strides


def _linear(values: np.ndarray, end: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Linear interpolation of m samples and the first one of the next stride."""
    closed, place = np.concatenate([values, end]), within * len(values)
    left = np.minimum(place.astype(int), len(values) - 1)
    weight = (place - left).reshape(-1, *(1,) * (values.ndim - 1))
    return closed[left] + weight * (closed[left + 1] - closed[left])


def displacement(motion: Motion, phase: np.ndarray) -> Pose:
    """Poses at phases (m,) of the frame that moves at the commanded twist from phase 0 on.

    Raises:
        ConfigurationError: the stride is not positive and finite, or the command does not have one
            to three numbers.
    """
    command = np.asarray(motion.command, dtype=float)
    if command.ndim != 1 or len(command) not in COMMAND_SIZES:
        raise ConfigurationError(
            "the command of a motion must be (forward speed,), (forward, sideways speed) or"
            f" (forward, sideways speed, yaw rate), got {command.tolist()}"
        )
    if not 0 < motion.stride < np.inf:
        raise ConfigurationError(f"stride must be positive and finite, got {motion.stride} s")
    return twist_pose(command, phase * motion.stride)
