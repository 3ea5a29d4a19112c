"""Unfold half a stride into a gait, and fold a gait back into half a stride."""

import numpy as np

from aslip.rom.assemble import POINTS, assemble, check_points, effort
from aslip.rom.certificate import Certificate
from aslip.rom.gait import Gait
from aslip.rom.problem import MIRROR, MIRROR_SIGN, HalfStride
from aslip.rom.slip import SlipParameters


def unfold(
    half: HalfStride, command: np.ndarray, certificate: Certificate, p: SlipParameters
) -> Gait:
    """Gait of half a stride (right single stance, double stance) and its mirror image."""
    step = float(command[0]) * (p.single_stance + half.double_stance)
    state = half.state[:, :-1]
    state = np.hstack([state, mirrored(state, step), half.state[:, :1]])
    state[0, -1] += 2 * step
    first = (half.single_control, half.double_control)
    durations = (p.single_stance, half.double_stance)
    cost = sum(effort(u, d) for u, d in zip(first, durations, strict=True))
    return assemble(
        command=command,
        double_stance=half.double_stance,
        state=state,
        controls=[*first, *(u[::-1] for u in first)],
        footholds=_footholds(half.right_foothold, step, p),
        cost=float(2 * cost),
        certificate=certificate,
        parameters=p,
    )


def fold(gait: Gait) -> HalfStride:
    """First half of a gait, an initial guess for the optimiser.

    Raises:
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    half = slice(0, 2 * POINTS + 1)
    state = np.hstack(
        [gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity]
    )
    return HalfStride(
        state=state[half].T,
        single_control=gait.control[: POINTS + 1].T,
        double_control=gait.control[POINTS : 2 * POINTS + 1].T,
        double_stance=gait.double_stance,
        right_foothold=float(gait.feet.position[0, 1, 0]),
    )


def mirrored(state: np.ndarray, step: float) -> np.ndarray:
    """Mirror states (10, n): left and right exchanged, one footstep ahead."""
    image = MIRROR_SIGN[:, None] * state[MIRROR]
    image[0] += step
    return image


def _footholds(right: float, step: float, p: SlipParameters) -> np.ndarray:
    """(2, 2, 3) start and end of the left and of the right swing [m]."""
    left, side, stride = right + step, p.foot_separation / 2, 2 * step
    return np.array(
        [
            [[left - stride, side, 0.0], [left, side, 0.0]],
            [[right, -side, 0.0], [right + stride, -side, 0.0]],
        ]
    )
