r"""Walk of the linear inverted pendulum in closed form: motion of a baseline and an ablation.

The body keeps its height z. Relative to each stance foot it follows the solution of
:math:`\ddot x = \omega^2 x` with :math:`\omega = \sqrt{g / z}` (Kajita et al. 2001) that repeats,
mirrored, at every footstep:

.. math::
    x(t) = \tfrac{L}{2}\,\frac{\sinh \omega (t - T/2)}{\sinh \omega T/2}, \qquad
    y(t) = -\tfrac{w}{2}\,\frac{\cosh \omega (t - T/2)}{\cosh \omega T/2}

for a footstep of length L, width w and duration T, relative to a left stance foot. The ground force
has a single, flat hump per stance. Swing feet move as in the spring-mass gaits; each lands
before the stance changes, and carries no load until then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aslip.base.checks import TINY, check_number
from aslip.rom.gait import Gait
from aslip.rom.motion import Angle, MotionSample, Track, displacement, split_phase
from aslip.rom.slip import SlipParameters
from aslip.rom.swing import swing_foot

_MODEL = SlipParameters()
# share of a footstep's duration for which the swing foot is in the air
_SWING_SHARE = 0.8


@dataclass(frozen=True)
class PendulumWalk:
    """Walk of the linear inverted pendulum.

    Default mass, width and clearance are those of the actuated spring-mass model, so that the two
    differ only in the motion of the body over its feet.

    Raises:
        ConfigurationError: a length, time or mass is not positive, or the speed is not finite.
    """

    speed: float = 0.75
    """Mean forward speed [m/s]; by default that of the published single-reference motion."""
    stride: float = 0.84
    """Duration of a stride, two footsteps [s]."""
    height: float = 0.92
    """Constant height of the body [m]; at the default the legs are slightly bent at mid-stance."""
    width: float = _MODEL.foot_separation
    """Lateral distance between the feet [m]."""
    clearance: float = _MODEL.swing_clearance
    """Height of a foot at mid-swing [m]."""
    mass: float = _MODEL.mass
    """Mass of the body [kg], which the ground forces carry."""

    def __post_init__(self) -> None:
        """Check the settings."""
        for name in ("stride", "height", "width", "clearance", "mass"):
            check_number(name, getattr(self, name), TINY)
        check_number("speed", self.speed, what="in m/s")

    @property
    def command(self) -> np.ndarray:
        """(1,) mean forward speed [m/s]."""
        return np.array([self.speed])

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Sample the walk at any phases (m,), 0 at left lift-off; the body starts at x = 0.

        Ground forces act on one foot at a time: in double stance the foot that has just landed
        carries no load.

        Raises:
            ShapeError: phase is not one-dimensional, or not finite.
        """
        strides, phase = split_phase(phase)
        body, feet = self._body(phase), self._feet(phase)
        second = phase >= 0.5
        carrying = np.stack([second, ~second], axis=1)[..., None]
        lever = body.position[:, None] - feet.position
        sample = MotionSample(
            body=body,
            feet=feet,
            ground_force=self.mass * self._rate**2 * lever * carrying,
            heading=Angle.zeros(len(phase)),
            foot_heading=np.zeros((len(phase), 2)),
        )
        return sample.moved(displacement(self, strides))

    @property
    def _rate(self) -> float:
        """Rate omega of the pendulum [1/s]."""
        return np.sqrt(_MODEL.gravity / self.height)

    def _body(self, phase: np.ndarray) -> Track:
        duration, length, omega = self.stride / 2, self.speed * self.stride / 2, self._rate
        second = phase >= 0.5
        time = (phase - 0.5 * second) * self.stride
        angle, end = omega * (time - duration / 2), omega * duration / 2
        # the right foot, at -y, is the first stance foot
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
            # a foot lifts off half a footstep behind the body
            first = np.array([(2 * begins - 0.5) * length, (0.5 - i) * self.width, 0.0])
            feet.append(
                swing_foot(
                    (phase - begins) * self.stride,
                    first,
                    first + np.array([2 * length, 0, 0]),
                    duration=_SWING_SHARE * duration,
                    clearance=self.clearance,
                )
            )
        return Track(
            np.stack([foot.position for foot in feet], axis=1),
            np.stack([foot.velocity for foot in feet], axis=1),
        )


def pendulum_walks(gaits: Sequence[Gait], walk: PendulumWalk | None = None) -> list[PendulumWalk]:
    """Pendulum walks with the speeds and strides of gaits.

    The body of a walk keeps the height of the gait's body at mid-stance, so that a foot at
    mid-swing is as far below the body as in the gait. At the gait's mean height, from 1.8 m/s on,
    the robot's legs are too long for the model's clearance.

    Args:
        gaits: gaits that give speeds, strides and heights.
        walk: mass, width and clearance of all walks; by default mass, width and
            clearance of each gait's model.
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
