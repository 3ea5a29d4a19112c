"""State of n robots from which a plan begins, and the motion of a foot in flight."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import prod
from typing import Final

from aslip.base.arrays import Array, is_numpy, namespace
from aslip.errors import ShapeError

# of the fields of a state, without the robots
_SHAPES = ((3,), (3,), *[(2, 3)] * 3, (2,), (3,), (), ())


@dataclass(frozen=True, eq=False, kw_only=True)
class WalkState:
    """State of n robots, each in its heading frame, as NumPy arrays or as tensors.

    The heading frame of a robot stands on the ground at any place, with x along the robot's heading
    and z up. Stance begins with the touchdown of the stance foot; the other foot lifts off after
    double stance.

    Raises:
        ShapeError: an array does not have its shape.
    """

    body_position: Array
    """(n, 3) [m]."""
    body_velocity: Array
    """(n, 3) [m/s]."""
    foot_position: Array
    """(n, 2, 3) left and right foot [m]."""
    foot_velocity: Array
    """(n, 2, 3) [m/s]; that of the stance foot counts as zero."""
    foot_acceleration: Array
    """(n, 2, 3) [m/s^2]. With the values of the last plan, a foot whose target does not change
    stays on its path."""
    foot_heading: Array
    """(n, 2) direction of the toes [rad]."""
    lift_off: Array
    """(n, 3) where the swing foot stood last [m]."""
    stance: Array
    """(n,) stance foot, 0 for left and 1 for right; the one that landed last."""
    since: Array
    """(n,) time since its touchdown [s]."""

    def __post_init__(self) -> None:
        """Check shapes."""
        n = len(self.since)
        for field, shape in zip(fields(self), _SHAPES, strict=True):
            shape = (n, *shape)
            found = tuple(getattr(self, field.name).shape)
            if found != shape:
                raise ShapeError(f"{field.name} of a state must be {shape}, got {found}")

    SIZE = 31
    """Numbers of a robot's state."""

    def to_rows(self) -> Array:
        """(n, 31) all numbers, in the order of the fields."""
        xp, n = namespace(self.since), len(self.since)
        dtype = self.body_position.dtype
        values = [getattr(self, field.name).reshape(n, -1) for field in fields(self)]
        return xp.concatenate([xp.asarray(value, dtype=dtype) for value in values], -1)

    @classmethod
    def from_rows(cls, rows: Array) -> WalkState:
        """State of rows (n, 31) of `to_rows`."""
        n, at, values = len(rows), 0, {}
        for field, shape in zip(fields(cls), _SHAPES, strict=True):
            size = prod(shape)
            values[field.name] = rows[:, at : at + size].reshape(n, *shape)
            at += size
        stance = values["stance"]
        values["stance"] = stance.astype(int) if is_numpy(stance) else stance.long()
        return cls(**values)

    def seen_from(self, place: Array, turn: Array) -> WalkState:
        """State in another frame, whose origin is at (n, 2) [m], turned by (n,) [rad]."""
        xp = namespace(turn)
        cosine, sine = xp.cos(turn), xp.sin(turn)

        def turned(vector: Array) -> Array:
            many = vector.ndim == 3
            c, s = (cosine[:, None], sine[:, None]) if many else (cosine, sine)
            x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
            return xp.stack([c * x + s * y, c * y - s * x, z], -1)

        shift = xp.concatenate([place, 0 * place[:, :1]], -1)
        return WalkState(
            body_position=turned(self.body_position - shift),
            body_velocity=turned(self.body_velocity),
            foot_position=turned(self.foot_position - shift[:, None]),
            foot_velocity=turned(self.foot_velocity),
            foot_acceleration=turned(self.foot_acceleration),
            foot_heading=self.foot_heading - turn[:, None],
            lift_off=turned(self.lift_off - shift),
            stance=self.stance,
            since=self.since,
        )

    @property
    def rows(self) -> Array:
        """(n,) indices of the robots."""
        return namespace(self.since).arange(len(self.since), device=self.since.device)

    def of_foot(self, values: Array, *, swing: bool) -> Array:
        """Values (n, ...) of the swing or of the stance foot, from those (n, 2, ...) of both."""
        return values[self.rows, 1 - self.stance if swing else self.stance]


def quintic(
    start: tuple[Array, Array, Array], end: tuple[Array, Array, Array], duration: Array, time: Array
) -> tuple[Array, Array, Array]:
    """Path of least jerk between two states: position, velocity, acceleration (*b, k).

    A path that is left and taken up again at any time, with what it has there, goes on unchanged.

    Args:
        start: position, velocity and acceleration at time 0, (*b, k) each [m, m/s, m/s^2].
        end: those at the end of the duration.
        duration: (*b,) positive [s].
        time: (*b,) from 0 to the duration [s].
    """
    span = duration[..., None]
    t = time[..., None] / span
    (x, v, a), (x1, v1, a1) = start, end
    v, v1, a, a1 = v * span, v1 * span, a * span**2, a1 * span**2
    c2 = a / 2
    # conditions at the end on the cubic, quartic and quintic term
    p, q, r = x1 - x - v - c2, v1 - v - a, a1 - a
    c3, c4, c5 = 10 * p - 4 * q + r / 2, -15 * p + 7 * q - r, 6 * p - 3 * q + r / 2
    position = x + t * (v + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    velocity = v + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
    acceleration = 2 * c2 + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))
    return position, velocity / span, acceleration / span**2


def _cubic(
    start: Array, speed: Array, end: Array, duration: Array, time: Array
) -> tuple[Array, Array, Array]:
    """Path of least acceleration that comes to rest at an end (n, k), and stays, see `quintic`."""
    xp, span = namespace(time), duration[:, None]
    t = xp.minimum(time, duration)[:, None] / span
    speed = speed * span
    c2, c3 = 3 * (end - start) - 2 * speed, 2 * (start - end) + speed
    position = start + t * (speed + t * (c2 + t * c3))
    velocity = (speed + t * (2 * c2 + t * 3 * c3)) / span
    acceleration = xp.where(t < 1, (2 * c2 + t * 6 * c3) / span**2, 0 * start)
    return position, velocity, acceleration


# acceleration at the top, per height and square of half the swing, of the least jerk there
_TOP = -20 / 3
SETTLE: Final = 0.05
"""Time before its touchdown at which a foot is above its foothold [s]."""
# speed at which a foot touches the ground: one that came to rest there would land long before its
# time at the least error of its height [m/s]
_SINKING = 0.8
LATER: Final = 0.04
"""Time after the touchdown at which the path of a foot would reach the ground [s]: feet of robots
touch it that much too early."""
# time of a swing before its top below which the foot goes straight down [s]
_LATE = 0.03


def swing(
    foot: tuple[Array, Array, Array],
    lift_off: Array,
    target: Array,
    times: tuple[Array, Array],
    clearance: float,
    time: Array,
) -> tuple[Array, Array, Array]:
    """Motion (n, 3) of feet in flight to their targets: position, velocity, acceleration.

    Seen from above, a path of least acceleration, which ends a little before the touchdown: a foot
    that touches the ground too early is on its foothold, too. Its fastest part is 1.5 times as fast
    as its mean; on one of least jerk, 1.875 times, hips reach the speed at which motors have no
    torque. The foot's height goes over a top in the middle of the swing, as in `aslip.rom.swing`,
    and from there down, to a little above the ground at the touchdown.

    Args:
        foot: position, velocity and acceleration (n, 3) now.
        lift_off: (n, 3) where the swing began [m].
        target: (n, 3) where it ends [m].
        times: (n,) times since lift-off and until touchdown [s].
        clearance: height of the top above the higher foothold [m].
        time: (n,) from now, up to the touchdown [s].
    """
    xp, (gone, left) = namespace(time), times
    settled = xp.minimum(left, (left - SETTLE).clip(SETTLE))
    level = _cubic(foot[0][:, :2], foot[1][:, :2], target[:, :2], settled, time)
    left = left + LATER
    half = (gone + left) / 2
    to_top = half - gone
    rising = (to_top > _LATE) & (time < to_top)
    falling_first = to_top <= _LATE
    top = xp.maximum(lift_off[:, 2], target[:, 2]) + clearance
    # the height to fall from the top, not that to rise: both halves meet with equal acceleration
    bend = _TOP * clearance / half**2
    zero = xp.zeros_like(top)
    now = tuple(one[:, 2] for one in foot)
    at_top = (top, zero, bend)
    begin = [xp.where(rising | falling_first, a, b) for a, b in zip(now, at_top, strict=True)]
    ends = [
        xp.where(rising, a, b)
        for a, b in zip(at_top, (target[:, 2], zero - _SINKING, zero), strict=True)
    ]
    began = xp.where(rising | falling_first, zero, to_top)
    span = xp.where(rising, to_top, left - began)
    height = quintic(
        (begin[0][:, None], begin[1][:, None], begin[2][:, None]),
        (ends[0][:, None], ends[1][:, None], ends[2][:, None]),
        span,
        time - began,
    )
    position, velocity, acceleration = (
        xp.concatenate([a, b], -1) for a, b in zip(level, height, strict=True)
    )
    return position, velocity, acceleration
