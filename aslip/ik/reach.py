"""Says why a leg cannot reach: by how much it misses, and which joint limit stops it."""

from __future__ import annotations

import numpy as np

from aslip.errors import UnreachablePoseError
from aslip.ik.equations import EQUATIONS, LOOPS, POSITION, Equations
from aslip.ik.leg import JOINTS, KNEE, TARSUS, LegGeometry
from aslip.ik.newton import MAX_STEP, LegAngles, guess
from aslip.ik.target import FootMotion
from aslip.robot import SIDES

_STEPS = 50
_SINGULAR = 1e-9

# closed loops come first; the last row is how far the toes are from pointing forward, without which
# backward would do as well
_WEIGHT = np.ones(EQUATIONS + 1)
_WEIGHT[LOOPS] = 1e3


def check_reach(legs: LegGeometry, found: LegAngles, feet: FootMotion) -> None:
    """Pass if every leg reaches its target within the joint limits.

    Raises:
        UnreachablePoseError: one does not; the message tells the first such pose, the foot, the
            distance it misses by, and what stops it.
    """
    beyond = (found.angle < legs.lower) | (found.angle > legs.upper)
    failed = ~found.solved | beyond.any(axis=-1)
    if not failed.any():
        return
    pose, side = (int(i) for i in np.unravel_index(failed.argmax(), failed.shape))
    closest, stopped = _closest(legs, feet.position[[pose]], feet.rotation[[pose]], side)
    raise UnreachablePoseError(
        f"pose {pose}: the {SIDES[side]} foot misses its target by "
        f"{np.linalg.norm(closest.residual[0, side, POSITION]):.4f} m and its direction by "
        f"{closest.toe_angle()[0, side]:.4f} rad: "
        f"{_reason(legs, closest.angle[0, side], stopped, side)}"
    )


def _closest(
    legs: LegGeometry, position: np.ndarray, rotation: np.ndarray, side: int
) -> tuple[Equations, np.ndarray]:
    """What one leg can do within its limits for one target, by Gauss-Newton.

    Returns:
        The equations there, and which of its hinges (8,) stay at a limit (bool).
    """
    lower, upper = legs.lower[side], legs.upper[side]
    angle = guess(legs, position, rotation)
    angle[0, side] = np.clip(angle[0, side], lower, upper)
    stopped = np.zeros(len(JOINTS), dtype=bool)
    for _ in range(_STEPS):
        equations = Equations.at(legs, angle, position, rotation)
        step, stopped = _bounded_step(
            _WEIGHT * np.append(equations.residual[0, side], equations.toes_forward()[0, side] - 1),
            _WEIGHT[:, None]
            * np.vstack([equations.jacobian()[0, side], equations.toes_jacobian()[0, side, :1]]),
            lower - angle[0, side],
            upper - angle[0, side],
        )
        angle[0, side] += step * MAX_STEP / max(MAX_STEP, np.abs(step).max())
    at_limit = np.isclose(angle[0, side], lower) | np.isclose(angle[0, side], upper)
    return Equations.at(legs, angle, position, rotation), stopped & at_limit


def _bounded_step(
    residual: np.ndarray, jacobian: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares step (8,) within bounds, and which elements (8,) a bound holds.

    Elements that would leave their bounds are held there one after the other, worst first, while
    the others make up for it.
    """
    step = np.zeros(len(JOINTS))
    held = np.zeros(len(JOINTS), dtype=bool)
    while not held.all():
        rest = residual + jacobian[:, held] @ step[held]
        step[~held] = -np.linalg.lstsq(jacobian[:, ~held], rest, rcond=_SINGULAR)[0]
        beyond = np.where(held, 0, np.maximum(lower - step, step - upper))
        worst = beyond.argmax()
        if beyond[worst] <= 0:
            break
        held[worst] = True
        step[worst] = np.clip(step[worst], lower[worst], upper[worst])
    return step, held


def _reason(legs: LegGeometry, angle: np.ndarray, stopped: np.ndarray, side: int) -> str:
    """What keeps a leg with hinges at `angle` (8,) from coming closer."""
    reasons = [
        f"{SIDES[side]}_{JOINTS[joint]} at its limit {angle[joint]:.4f} rad "
        f"({np.rad2deg(angle[joint]):.4g} deg)"
        for joint in np.flatnonzero(stopped)
    ]
    if stopped[KNEE] or stopped[TARSUS]:
        middle = (legs.lower[side, KNEE] + legs.upper[side, KNEE]) / 2
        reasons.insert(0, f"leg fully {'stretched' if angle[KNEE] > middle else 'bent'}")
    return ", ".join(reasons) or "its loops cannot be closed there"
