"""Standing, and the transitions between stepping in place and standing.

    gait = optimize_gait([0.0, 0.0, 0.0], parameters=SlipParameters(min_stance_force=0.15))
    stop, start = optimize_transitions(gait)     # after the left touchdown
    standing = Standing.after(stop)
    stop.mirrored()                              # after the right touchdown

All are motions, see `aslip.rom.Motion`, in the frame of the gait, with the zero command and both
feet on the ground. A transition is not periodic: beyond its ends it holds its first or last sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aslip.rom.certificate import Certificate
from aslip.rom.motion import Angle, MotionSample, Track
from aslip.rom.slip import SlipParameters, leg_forces

_SIGN = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Transition:
    """Motion from stepping in place to standing, or back, within one double stance of the gait.

    A stop begins with the state of the gait at a touchdown, a start ends with that at the lift-off
    of the other foot. Arrays are read-only.
    """

    stride: float
    """Duration [s]; phase 1 is its end."""
    time: np.ndarray
    """(n,) from 0 to `stride` [s]: nodes and midpoints of the collocation intervals."""
    body: Track
    """(n, 3) point mass."""
    feet: np.ndarray
    """(2, 3) left and right foot [m]."""
    set_point: np.ndarray
    """(n, 2) actuator set points of the left and right leg [m]."""
    set_point_velocity: np.ndarray
    """(n, 2) rates of the set points [m/s]."""
    control: np.ndarray
    """(n, 2) actuator accelerations u [m/s^2]."""
    certificate: Certificate
    """Evidence of optimality and feasibility, shared by stop and start."""
    parameters: SlipParameters
    """Model and bounds of the motion."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in ("time", "feet", "set_point", "set_point_velocity", "control"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        track = Track(_frozen(self.body.position), _frozen(self.body.velocity))
        object.__setattr__(self, "body", track)

    @property
    def command(self) -> np.ndarray:
        """(3,) zero command."""
        return np.zeros(3)

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Motion at phases (m,), 0 at its start and 1 at its end.

        Body and set points are cubic Hermite interpolants, as in `aslip.rom.Gait`.
        """
        time = np.clip(np.asarray(phase, dtype=float), 0.0, 1.0) * self.stride
        body = self.body.interpolated(self.time, time)
        set_point = Track(self.set_point, self.set_point_velocity).interpolated(self.time, time)
        return _planted(body, set_point, self.feet, self.parameters)

    def mirrored(self) -> Transition:
        """Mirror image, left and right exchanged."""
        legs = ("set_point", "set_point_velocity", "control")
        return replace(
            self,
            body=Track(self.body.position * _SIGN, self.body.velocity * _SIGN),
            feet=(self.feet * _SIGN)[::-1],
            certificate=self.certificate.mirrored(),
            **{name: getattr(self, name)[:, ::-1] for name in legs},
        )


@dataclass(frozen=True, eq=False)
class Standing:
    """Rest in static equilibrium on both feet, the end of a stop."""

    body: np.ndarray
    """(3,) point mass [m]."""
    feet: np.ndarray
    """(2, 3) left and right foot [m]."""
    set_point: np.ndarray
    """(2,) actuator set points [m]."""
    parameters: SlipParameters
    """Model of the legs."""

    @classmethod
    def after(cls, stop: Transition) -> Standing:
        """Rest in which a stop ends."""
        return cls(stop.body.position[-1], stop.feet, stop.set_point[-1], stop.parameters)

    @property
    def command(self) -> np.ndarray:
        """(3,) zero command."""
        return np.zeros(3)

    @property
    def stride(self) -> float:
        """Duration of a stride: infinite."""
        return np.inf

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Rest at phases (m,); all phases have the same pose."""
        body, set_point = (
            Track(np.tile(value, (len(phase), 1)), np.zeros((len(phase), len(value))))
            for value in (self.body, self.set_point)
        )
        return _planted(body, set_point, self.feet, self.parameters)


def _planted(body: Track, set_point: Track, feet: np.ndarray, p: SlipParameters) -> MotionSample:
    """Sample (m,) of a body (m, 3) on both legs, set points (m, 2), with planted feet (2, 3)."""
    count = len(body.position)
    _, force = leg_forces(body, feet, set_point, p)
    return MotionSample(
        body=body,
        feet=Track(np.tile(feet, (count, 1, 1)), np.zeros((count, 2, 3))),
        ground_force=force,
        heading=Angle.zeros(count),
        foot_heading=np.zeros((count, 2)),
    )


def _frozen(array: np.ndarray) -> np.ndarray:
    copy = np.array(array, dtype=float)
    copy.setflags(write=False)
    return copy
