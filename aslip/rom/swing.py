r"""Swing foot: path of least integrated squared jerk between two footholds (Sec. III-A).

Paper says the profile has minimum jerk and a given clearance at the midpoint. Its public gaits land
one collocation node early, after 48/49 of the single stance; ours fills the single stance exactly,
lift-off to touchdown, because a foot on the ground is in stance. The forward profile is one
rest-to-rest quintic, the vertical profile two quintics that meet at the clearance height. Seen from
above, the path is straight, or the arc on which a turning stride carries the foot.

The quintic is fastest at half swing, 1.875 times its mean speed, which at 2 m/s is twice what
Cassie's hip can do. A profile that speeds up and slows down in a share of the swing, and is steady
in between, is slower there and lands more softly.

Both profiles are functions of swing fraction s in [0, 1]; derivatives are per unit of s. Outside
[0, 1] a profile holds the value of the nearer end.
"""

import numpy as np

from aslip.rom.arc import rotate
from aslip.rom.motion import Track

# s^3 (10 - 15 s + 6 s^2), the quintic with zero velocity and acceleration at 0 and 1
_TRAVEL = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
# integral over t in [0, 1] of the quintic _TRAVEL: from rest to steady speed 1
_SPEED_UP = np.polynomial.Polynomial([0, 0, 0, 0, 2.5, -3, 1])
# rise over t in [0, 1]: zero value, velocity and acceleration at 0; at 1, where it meets its mirror
# image, value 1 and the odd derivatives of order 1 and 3 zero, so derivatives to order 4 match
_RISE = np.polynomial.Polynomial(np.array([0, 0, 0, 20, -25, 8]) / 3.0)


def travel(fraction: np.ndarray, order: int = 0, *, ramp: float | None = None) -> np.ndarray:
    """Share of the distance between footholds, or one of its derivatives.

    Args:
        fraction: swing fraction s, any shape.
        order: 0 for the share, 1 for velocity, 2 for acceleration, ... (per unit of s).
        ramp: share of the swing, at most half, in which the foot speeds up, and of that in which it
            slows down; None for the profile of least jerk.

    Returns:
        Array in the shape of `fraction`.
    """
    s = np.clip(fraction, 0.0, 1.0)
    if ramp is None:
        return np.asarray(_TRAVEL.deriv(order)(s))
    # the second half is the first one run backwards
    late, t = s > 0.5, np.minimum(s, 1.0 - s) / ramp
    steady = np.polynomial.Polynomial([-0.5, 1.0])
    half = np.where(t < 1, _SPEED_UP.deriv(order)(t), steady.deriv(order)(t))
    half = half * ramp ** (1 - order) / (1 - ramp)
    if order == 0:
        return np.where(late, 1.0 - half, half)
    return np.where(late, -((-1.0) ** order), 1.0) * half


def lift(fraction: np.ndarray, order: int = 0) -> np.ndarray:
    """Height above ground as a share of the clearance, or one of its derivatives.

    The spline is four times continuously differentiable at s = 1/2, as least jerk with a via point
    requires; it rests at both ends and, by symmetry, at the top.

    Args:
        fraction: swing fraction s, any shape.
        order: 0 for the height, 1 for velocity, 2 for acceleration, ... (per unit of s).

    Returns:
        Array in the shape of `fraction`.
    """
    s = np.clip(fraction, 0.0, 1.0)
    # the second half is the first one run backwards: odd derivatives change sign; d/ds = 2 d/dt
    sign = np.where(s > 0.5, (-1.0) ** order, 1.0)
    return sign * 2.0**order * _RISE.deriv(order)(2.0 * np.minimum(s, 1.0 - s))


def swing_foot(
    time: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    *,
    duration: float,
    clearance: float,
    ramp: float | None = None,
    turn: float = 0.0,
) -> Track:
    """Motion of a foot that swings once.

    Args:
        time: (m,) since lift-off [s]; negative before it.
        start: foothold until lift-off (3,) [m].
        end: foothold from touchdown on (3,) [m], at equal height.
        duration: duration of the swing [s].
        clearance: height at half swing [m].
        ramp: see `travel`.
        turn: angle between the directions at both ends of the path, seen from above [rad]; 0 is
            straight.

    Returns:
        Track of shape (m, 3).
    """
    fraction = time / duration
    share, share_rate = (travel(fraction, order, ramp=ramp) for order in (0, 1))
    # an arc is the path of a constant twist, see `aslip.rom.arc.twist_pose`
    tangent = np.subtract(end, start) / _sinc(turn / 2)
    path = np.multiply.outer(share * _sinc(share * turn / 2), tangent)
    velocity = rotate(np.multiply.outer(share_rate, tangent), (share - 0.5) * turn)
    up = np.array([0.0, 0.0, clearance])
    rise, rise_rate = (np.multiply.outer(lift(fraction, order), up) for order in (0, 1))
    return Track(
        rotate(path, (share - 1.0) * turn / 2) + rise + start, (velocity + rise_rate) / duration
    )


def _sinc(angle: np.ndarray | float) -> np.ndarray:
    """Unnormalised sine cardinal."""
    return np.sinc(np.asarray(angle) / np.pi)
