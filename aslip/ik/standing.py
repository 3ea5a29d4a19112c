"""The pose in which the robot stands still: both legs vertical, soles under the centre of mass."""

from __future__ import annotations

import numpy as np

from aslip.errors import UnreachablePoseError
from aslip.ik.kinematics import CassieKinematics
from aslip.ik.leg import FOOT
from aslip.ik.solve import IkSolution, solve
from aslip.ik.target import BodyTarget

_TOLERANCE = 1e-12
_MAX_ITERATIONS = 50


def standing_pose(kinematics: CassieKinematics, height: float = 0.95) -> IkSolution:
    """One pose (n = 1) with an upright pelvis above the origin and level soles on the floor z = 0.

    The legs' planes are vertical, so the soles do not lean. The soles' centres are below the centre
    of mass, which moves with the legs: a fixed point, found by iteration.

    Args:
        kinematics: the robot.
        height: of the pelvis above the floor [m].

    Raises:
        UnreachablePoseError: the legs are too short or too long for that height.
    """
    pelvis = BodyTarget(np.array([[0.0, 0.0, height]]))
    lateral = _lateral(kinematics)
    forward = 0.0
    for _ in range(_MAX_ITERATIONS):
        feet = [BodyTarget(np.array([[forward, y, 0.0]])) for y in lateral]
        solution = solve(kinematics, pelvis, *feet)
        centre = float(kinematics.forward(solution.qpos).centre_of_mass[0, 0])
        if abs(centre - forward) < _TOLERANCE:
            return solution
        forward = centre
    raise UnreachablePoseError(f"no standing pose found at height {height!r}")


def _lateral(kinematics: CassieKinematics) -> np.ndarray:
    """(2,) y of the soles' centres when the legs are vertical [m]: what the drawn pose has."""
    legs = kinematics.legs
    drawn = legs.frames(legs.drawn[None])
    return drawn.point(FOOT, legs.sole)[0, :, 1]
