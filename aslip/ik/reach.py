"""Error for a foot target out of reach: distance missed, and joint limits that stop the leg."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from aslip.errors import UnreachablePoseError
from aslip.ik.equations import POSITION, Equations
from aslip.ik.kinematics import Kinematics
from aslip.ik.target import FootMotion
from aslip.robot import SIDES

_LOOP_WEIGHT = 1e3  # closed loops come first
_DIRECTION_WEIGHT = 0.3  # an error of 1 rad counts as much as one of 0.3 m
_ALONG = 0.9  # if the cosine between leg and miss is above this, the leg is too short or too long


def unreachable(
    kinematics: Kinematics, feet: FootMotion, pose: int, side: int
) -> UnreachablePoseError:
    """Error with the pose, the foot, the distance missed and the joint limits reached."""
    target = feet.take([pose])
    closest, held = _closest(kinematics, target, side)
    miss = -closest.residual[0, side, POSITION]
    reasons = [
        f"{name} at its limit {limit:.4f} rad ({np.rad2deg(limit):.4g} deg)"
        for name, limit in held.items()
    ]
    leg = target.position[0, side] - kinematics.hips[side]
    along = miss @ leg / max(np.linalg.norm(miss) * np.linalg.norm(leg), np.finfo(float).tiny)
    if reasons and abs(along) > _ALONG:
        reasons.insert(0, f"leg fully {'stretched' if along > 0 else 'bent'}")
    direction = closest.toe_angle()[0, side]
    return UnreachablePoseError(
        f"pose {pose}: the {SIDES[side]} foot misses its target by {np.linalg.norm(miss):.4f} m "
        f"and its direction by {direction:.4f} rad: "
        f"{', '.join(reasons) or 'no posture of the leg comes closer'}"
    )


def _closest(
    kinematics: Kinematics, target: FootMotion, side: int
) -> tuple[Equations, dict[str, float]]:
    """Equations of the closest posture of a leg to a target, and the joint limits reached."""
    start = kinematics.start[None]

    def at(change: np.ndarray) -> Equations:
        step = np.zeros(kinematics.leg_v.shape)
        step[side] = change
        return Equations.at(kinematics, kinematics.integrate(start, step[None]), target)

    def residual(change: np.ndarray) -> np.ndarray:
        equations = at(change)
        weight = np.full(equations.residual.shape[-1], _LOOP_WEIGHT)
        weight[POSITION], weight[equations.direction] = 1, _DIRECTION_WEIGHT
        # toes that point backward have the same sideways and upward residual as forward ones
        backward = _DIRECTION_WEIGHT * (equations.sole_to_target[0, side, 0, 0] - 1)
        return np.append(weight * equations.residual[0, side], backward)

    angle = kinematics.start[kinematics.leg_q[side]]
    lower, upper = kinematics.lower[side], kinematics.upper[side]
    found = least_squares(
        residual, np.zeros(len(angle)), bounds=(lower - angle, upper - angle), x_scale="jac"
    )
    limit = np.where(found.active_mask < 0, lower, upper)
    held = np.flatnonzero(found.active_mask)
    return at(found.x), {kinematics.leg_joints[side][i]: float(limit[i]) for i in held}
