r"""Linear pendulum of a walking body in closed form: :math:`\ddot c = \omega^2 (c - r)`.

The centre of pressure r rests on the stance foot. In double stance it moves there from the last
foothold at constant speed. The divergent component :math:`\xi = c + \dot c / \omega` and the
convergent one :math:`\zeta = c - \dot c / \omega` each obey an equation of first order,

.. math:: \dot u = \lambda (u - r), \qquad \lambda = \omega \text{ or } -\omega,

so that a component relative to the stance foot p is, T after r was at q,

.. math::
    u(T) - p = e^{\lambda T} \left(u(0) - p + \beta (p - q)\right), \qquad
    \beta = 1 - \frac{1 - e^{-\lambda D}}{\lambda D}

where D <= T is the time that r takes from q to p. Time T enters by the factor alone, which makes
the time of a touchdown a variable of a quadratic program (Khadiv et al. 2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from aslip.base.arrays import Array, namespace
from aslip.base.checks import TINY, check_number
from aslip.rom.slip import SlipParameters

_MODEL = SlipParameters()
# share of a step at which the body of the library's gaits is highest
_APEX = 0.63
# duration that stands for none [s]
_INSTANT = 1e-9


@dataclass(frozen=True)
class Pendulum:
    """Constants of the linear pendulum.

    Raises:
        ConfigurationError: a constant is not positive and finite, or the time of double stance is
            not below the time of a step.
    """

    rate: float = 2.85
    """Rate omega [1/s]. It predicts falls of Cassie better than the 3.3 of a pendulum of its
    height, because the legs give way."""
    double_stance: float = 0.1
    """Duration of double stance after each touchdown [s]."""
    step_time: float = 0.4
    """Nominal time between touchdowns [s], as in the library's gaits."""
    height: float = 0.9
    """Mean height of the body above the footholds [m]."""
    bounce: float = 0.035
    """Amplitude of the body's height within a nominal or longer step [m], as in the gaits of the
    library: highest in single stance, and falling at touchdown. Without it feet land 0.06 s before
    their time."""
    mass: float = _MODEL.mass
    """Mass of the body [kg], for ground forces."""
    gravity: float = _MODEL.gravity
    """Gravitational acceleration [m/s^2], for ground forces."""

    def __post_init__(self) -> None:
        """Check the constants."""
        for name in ("rate", "step_time", "height", "mass", "gravity"):
            check_number(name, getattr(self, name), TINY)
        check_number("bounce", self.bounce, 0.0)
        check_number("double_stance", self.double_stance, TINY, 0.9 * self.step_time)

    def bounced(self, since: Array, duration: Array) -> tuple[Array, Array, Array]:
        """Height (*b,) above that of the pendulum [m], its rate [m/s] and acceleration [m/s^2].

        Steps shorter than nominal bounce less, with no more acceleration: else bodies would fly.

        Args:
            since: (*b,) time since the last touchdown [s].
            duration: (*b,) time from there to the next one [s].
        """
        xp, rate = namespace(since), 2 * math.pi / duration
        angle = rate * since - 2 * math.pi * _APEX
        high = self.bounce * (duration / self.step_time).clip(None, 1.0) ** 2
        height = high * xp.cos(angle)
        return height, -high * rate * xp.sin(angle), -(rate**2) * height

    def shift(self, sign: int, duration: Array) -> Array:
        """Weight beta (*b,) of the shift of pressure in a component.

        Args:
            sign: 1 for the divergent and -1 for the convergent component.
            duration: (*b,) time D that the shift takes [s]; 0 for none.
        """
        xp, exponent = namespace(duration), self.rate * duration.clip(_INSTANT)
        return 1 + sign * xp.expm1(-sign * exponent) / exponent

    def flow(
        self, body: Array, velocity: Array, start: Array, stance: Array, shift: Array, time: Array
    ) -> tuple[Array, Array]:
        """Position and velocity (*b, 2) of the body later in the step [m, m/s].

        Args:
            body: (*b, 2) position of the body now [m].
            velocity: (*b, 2) its velocity [m/s].
            start: (*b, 2) centre of pressure now [m].
            stance: (*b, 2) foothold that carries the body after the shift [m].
            shift: (*b,) time until the centre of pressure is there [s].
            time: (*b,) time from now [s].
        """
        xp = namespace(body)
        shift, time = shift.clip(_INSTANT)[..., None], time[..., None]
        moving = xp.minimum(time, shift)
        pressure_speed = (stance - start) / shift
        pressure = start + pressure_speed * moving
        found = []
        for rate in (self.rate, -self.rate):
            component = body + velocity / rate
            offset = pressure_speed / rate
            component = pressure + offset + (component - start - offset) * xp.exp(rate * moving)
            found.append(pressure + (component - pressure) * xp.exp(rate * (time - moving)))
        divergent, convergent = found
        return (divergent + convergent) / 2, (divergent - convergent) * (self.rate / 2)
