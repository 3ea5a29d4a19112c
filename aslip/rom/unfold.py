"""Unfold half a stride into a gait, and fold a gait back into half a stride."""

import numpy as np

from aslip.errors import ShapeError
from aslip.rom import collocation
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import leg_function
from aslip.rom.gait import Gait, swinging_feet
from aslip.rom.motion import Track
from aslip.rom.problem import INTERVALS, MIRROR, MIRROR_SIGN, HalfStride
from aslip.rom.slip import Mode, SlipParameters

_POINTS = 2 * INTERVALS
"""Collocation points per contact mode, except the last one, which opens the next mode."""


def unfold(half: HalfStride, speed: float, certificate: Certificate, p: SlipParameters) -> Gait:
    """Gait of half a stride (right single stance, double stance) and its mirror image."""
    half_period = p.single_stance + half.double_stance
    step = speed * half_period
    time = np.r_[
        np.linspace(0.0, p.single_stance, _POINTS, endpoint=False),
        np.linspace(p.single_stance, half_period, _POINTS, endpoint=False),
    ]
    time = np.r_[time, time + half_period, 2 * half_period]

    state = half.state[:, :-1]
    state = np.hstack([state, mirrored(state, step), half.state[:, :1]])
    state[0, -1] += 2 * step
    control = np.hstack([half.single_control[:, :-1], half.double_control[:, :-1]])
    control = np.hstack([control, control[::-1], control[:, :1]])
    modes = (Mode.RIGHT, Mode.DOUBLE, Mode.LEFT, Mode.DOUBLE)
    mode = np.r_[np.repeat([int(m) for m in modes], _POINTS), int(Mode.RIGHT)]

    right, left = half.right_foothold, half.right_foothold + step
    footholds = _footholds(left, right, step, p)
    force = _forces(state, mode, footholds, half_period, time, p)
    return Gait(
        speed=speed,
        stride=2 * half_period,
        time=time,
        mode=mode,
        body=Track(state[0:3].T, state[3:6].T),
        feet=swinging_feet(time, 2 * half_period, footholds, p),
        leg_force=force,
        set_point=state[6:8].T,
        set_point_velocity=state[8:10].T,
        control=control.T,
        cost=2 * _effort(half, p),
        certificate=certificate,
        parameters=p,
    )


def fold(gait: Gait) -> HalfStride:
    """First half of a gait, an initial guess for the optimiser.

    Raises:
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    if len(gait.time) != 4 * _POINTS + 1:
        raise ShapeError(
            f"a guess needs {4 * _POINTS + 1} collocation points, got {len(gait.time)}"
        )
    half = slice(0, 2 * _POINTS + 1)
    state = np.hstack(
        [gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity]
    )
    return HalfStride(
        state=state[half].T,
        single_control=gait.control[: _POINTS + 1].T,
        double_control=gait.control[_POINTS : 2 * _POINTS + 1].T,
        double_stance=gait.double_stance,
        right_foothold=float(gait.feet.position[0, 1, 0]),
    )


def mirrored(state: np.ndarray, step: float) -> np.ndarray:
    """Mirror states (10, n): left and right exchanged, one step ahead."""
    image = MIRROR_SIGN[:, None] * state[MIRROR]
    image[0] += step
    return image


def _footholds(left: float, right: float, step: float, p: SlipParameters) -> np.ndarray:
    """(2, 2, 3) start and end of the left and of the right swing [m]."""
    side, stride = p.foot_separation / 2, 2 * step
    return np.array(
        [
            [[left - stride, side, 0.0], [left, side, 0.0]],
            [[right, -side, 0.0], [right + stride, -side, 0.0]],
        ]
    )


def _forces(
    state: np.ndarray,
    mode: np.ndarray,
    footholds: np.ndarray,
    half_period: float,
    time: np.ndarray,
    p: SlipParameters,
) -> np.ndarray:
    """Leg forces (n, 2) [N], 0 in swing."""
    # the stance foothold of the left foot is its second one, of the right foot only once landed
    landed = time >= half_period + p.single_stance
    left = np.repeat(footholds[0, 1][:, None], len(time), axis=1)
    right = np.where(landed, footholds[1, 1][:, None], footholds[1, 0][:, None])
    force = np.array(leg_function(p)(state, left, right)[0]).T
    in_swing = np.stack([mode == Mode.RIGHT, mode == Mode.LEFT], axis=1)
    return np.where(in_swing, 0.0, force)


def _effort(half: HalfStride, p: SlipParameters) -> float:
    """Integral of u_l^2 + u_r^2 over half a stride [m^2/s^3]."""
    weight = collocation.weights(INTERVALS)
    single = p.single_stance / INTERVALS * np.sum(half.single_control**2 @ weight)
    double = half.double_stance / INTERVALS * np.sum(half.double_control**2 @ weight)
    return float(single + double)
