r"""Walking of the linear inverted pendulum, in closed form: reference of baseline and ablation.

The body keeps its height z and follows, from each stance foot, the orbit of
:math:`\ddot x = \omega^2 x` with :math:`\omega = \sqrt{g / z}` (Kajita et al. 2001) that repeats
itself, mirrored, step after step:

.. math::
    x(t) = \tfrac{L}{2}\,\frac{\sinh \omega (t - T/2)}{\sinh \omega T/2}, \qquad
    y(t) = -\tfrac{w}{2}\,\frac{\cosh \omega (t - T/2)}{\cosh \omega T/2}

for a step of length L, width w and duration T; y is away from a left stance foot to the right. The
force on the ground then has a single, flat hump a stance. Swing feet move as those of the
spring-mass gaits, and wait on the ground before they take over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aslip.errors import ConfigurationError
from aslip.rom.gait import Gait
from aslip.rom.motion import Angle, MotionSample, Track, displacement, split_phase
from aslip.rom.slip import SlipParameters
from aslip.rom.swing import swing_foot

_MODEL = SlipParameters()


@dataclass(frozen=True)
class PendulumWalk:
    """A walk of the linear inverted pendulum.

    Mass, width and clearance are by default those of the actuated spring-mass model, so that the
    two differ in nothing but how the body moves over its feet.

    Raises:
        ConfigurationError: a length, time or mass is not positive, the share not within (0, 1], or
            the speed not finite.
    """

    speed: float = 0.75
    """Mean forward speed [m/s]; as the motion that the single-reference method was published
    with."""
    stride: float = 0.84
    """Duration of a stride, two steps [s]."""
    height: float = 0.92
    """Constant height of the body [m]; with it, the legs are a little bent as they pass."""
    width: float = _MODEL.foot_separation
    """Sideways distance of the feet [m]."""
    clearance: float = _MODEL.swing_clearance
    """Height of a foot in the middle of its swing [m]."""
    mass: float = _MODEL.mass
    """Mass of the body [kg]; joint torques carry its weight."""
    swing_share: float = 0.8
    """Share of a step that the foot is in the air."""

    def __post_init__(self) -> None:
        """Check the settings."""
        for name in ("stride", "height", "width", "clearance", "mass"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)!r}")
        if not 0 < self.swing_share <= 1:
            raise ConfigurationError(f"swing_share must be in (0, 1], got {self.swing_share!r}")
        if not np.isfinite(self.speed):
            raise ConfigurationError(f"speed must be finite [m/s], got {self.speed!r}")

    @property
    def command(self) -> np.ndarray:
        """(1,) mean forward speed [m/s]."""
        return np.array([self.speed])

    def sample(self, phase: np.ndarray) -> MotionSample:
        """The walk at any phases (m,), 0 at left lift-off; the body starts at x = 0.

        Forces are those on the feet of a body of the walk's mass. While both feet stand, the one
        that came down bears nothing yet.
        """
        strides, phase = split_phase(phase)
        ahead = displacement(self, strides)
        body, feet = self._body(phase), self._feet(phase)
        second = phase >= 0.5
        carrying = np.stack([second, ~second], axis=1)[..., None]
        lever = body.position[:, None] - feet.position
        return MotionSample(
            body=Track(body.position + ahead, body.velocity),
            feet=Track(feet.position + ahead[:, None], feet.velocity),
            ground_force=self.mass * self._rate**2 * lever * carrying,
            heading=Angle.zeros(len(phase)),
            foot_heading=np.zeros((len(phase), 2)),
        )

    @property
    def _rate(self) -> float:
        """Rate omega of the pendulum [1/s]."""
        return np.sqrt(_MODEL.gravity / self.height)

    def _body(self, phase: np.ndarray) -> Track:
        duration, length, omega = self.stride / 2, self.speed * self.stride / 2, self._rate
        second = phase >= 0.5
        time = (phase - 0.5 * second) * self.stride
        angle, end = omega * (time - duration / 2), omega * duration / 2
        # the right foot, at -y, carries first
        side = np.where(second, -1.0, 1.0)
        start = np.where(second, length, 0.0)
        flat = np.zeros_like(time)
        position = [
            start + length / 2 * (1 + np.sinh(angle) / np.sinh(end)),
            side * self.width / 2 * (np.cosh(angle) / np.cosh(end) - 1),
            flat + self.height,
        ]
        velocity = [
            length / 2 * np.cosh(angle) / np.sinh(end),
            side * self.width / 2 * np.sinh(angle) / np.cosh(end),
            flat,
        ]
        return Track(np.stack(position, axis=1), omega * np.stack(velocity, axis=1))

    def _feet(self, phase: np.ndarray) -> Track:
        """Left and right foot, (m, 2, 3); the left swings in the first half of the stride."""
        duration, length = self.stride / 2, self.speed * self.stride / 2
        feet = []
        for i, begins in enumerate((0.0, 0.5)):
            # a foot stands one half step before and behind the middle of its stances
            first = np.array([(2 * begins - 0.5) * length, (0.5 - i) * self.width, 0.0])
            feet.append(
                swing_foot(
                    (phase - begins) * self.stride,
                    first,
                    first + np.array([2 * length, 0, 0]),
                    duration=self.swing_share * duration,
                    clearance=self.clearance,
                )
            )
        return Track(
            np.stack([foot.position for foot in feet], axis=1),
            np.stack([foot.velocity for foot in feet], axis=1),
        )


def pendulum_walks(gaits: Sequence[Gait], walk: PendulumWalk | None = None) -> list[PendulumWalk]:
    """Pendulum walks of the same speeds and strides as gaits.

    Each keeps the height that the body of the gait whose place it takes has in the middle of a
    stance, so that a foot in mid-swing is as far below the body as the gait's. At the gait's mean
    height the robot's legs are too long for the model's clearance from 1.8 m/s on.

    Args:
        gaits: the gaits.
        walk: mass, width, clearance and share of swing of all of them; by default mass, width and
            clearance of the gait's own model.
    """
    walks = []
    for gait in gaits:
        p = gait.parameters
        base = walk or PendulumWalk(
            width=p.foot_separation, clearance=p.swing_clearance, mass=p.mass
        )
        height = float(gait.body.position[:, 2].max())
        walks.append(replace(base, speed=gait.speed, stride=gait.stride, height=height))
    return walks
