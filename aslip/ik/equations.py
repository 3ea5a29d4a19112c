"""Equations that a pose of the legs satisfies, and their Jacobian.

====================  ===========================================================================
rows of a leg         equation
====================  ===========================================================================
3                     the centre of the sole is at its target [m]
motors - 3            the sole has the orientation of its target; with five motors, only the toes
                      (x axis) have their direction, and the roll about them follows from the leg
3 for each loop       the loop is closed [m]
1 for each rod        a rod between a ball joint and a loop's end does not spin about its axis
====================  ===========================================================================

Springs are at rest. A planar loop has a row that is always zero, so that there may be more rows
than velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aslip.ik.kinematics import Kinematics
from aslip.ik.target import FootMotion
from aslip.robot.rotation import cross

POSITION: Final = slice(0, 3)

# entries of the rotation from sole to target that vanish: toes left, toes up, left side up
_ROWS, _COLUMNS = (1, 2, 2), (0, 0, 1)

_DAMPING = 1e-12  # keeps singular poses finite; elsewhere the refinement removes its effect


@dataclass(frozen=True)
class Equations:
    """Residual of both legs' equations in n configurations, with its Jacobian."""

    residual: np.ndarray
    """(n, 2, rows)."""
    jacobian: np.ndarray
    """(n, 2, rows, k) with respect to the velocities of each leg."""
    sole_to_target: np.ndarray
    """(n, 2, 3, 3) rotation."""
    turn: np.ndarray
    """(n, 2, motors - 3, 3) derivative of the orientation rows with respect to the angular velocity
    of the sole."""

    @classmethod
    def at(cls, kinematics: Kinematics, configuration: np.ndarray, feet: FootMotion) -> Equations:
        """Evaluate Pinocchio's configurations (n, nq), pelvis at the origin, for n targets."""
        legs = kinematics.legs(configuration)
        pelvis_to_target = np.swapaxes(feet.rotation, -1, -2)
        sole_to_target = pelvis_to_target @ legs.rotation
        free = kinematics.leg_motors.shape[1] - 3
        rows, columns = _ROWS[:free], _COLUMNS[:free]
        soles = np.swapaxes(legs.rotation, -1, -2)
        turn = cross(soles[..., columns, :], pelvis_to_target[..., rows, :])
        linear, angular = legs.jacobian[..., :3, :], legs.jacobian[..., 3:, :]
        offset, direction = legs.position - feet.position, sole_to_target[..., rows, columns]
        return cls(
            residual=np.concatenate((offset, direction, legs.closure), axis=-1),
            jacobian=np.concatenate((linear, turn @ angular, legs.closure_jacobian), axis=-2),
            sole_to_target=sole_to_target,
            turn=turn,
        )

    @property
    def direction(self) -> slice:
        """Rows of the sole's orientation."""
        return slice(POSITION.stop, POSITION.stop + self.turn.shape[-2])

    def loop_gap(self, kinematics: Kinematics) -> np.ndarray:
        """(n, 2, l) gaps of the loops [m]."""
        first = self.direction.stop
        rows = self.residual[..., first : first + kinematics.loop_rows]
        return np.linalg.norm(rows.reshape(*rows.shape[:-1], kinematics.loop_rows // 3, 3), axis=-1)

    def solved(self, tolerance: float) -> np.ndarray:
        """(n, 2) legs that satisfy their equations, with toes that point forward, not backward."""
        forward = self.sole_to_target[..., 0, 0] > 0
        return forward & (np.abs(self.residual) <= tolerance).all(-1)

    def toe_angle(self) -> np.ndarray:
        """(n, 2) angle between the toes and their target direction [rad]."""
        toes = self.sole_to_target[..., 0]
        return np.arctan2(np.linalg.norm(toes[..., 1:], axis=-1), toes[..., 0])


def least_squares(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Batched solution x of `matrix @ x = vector`, (..., r, k) and (..., r, m) -> (..., k, m).

    Normal equations, refined once; NumPy has no batched least squares.
    """
    transposed = np.swapaxes(matrix, -1, -2)
    normal = transposed @ matrix + _DAMPING * np.eye(matrix.shape[-1])
    solution = np.linalg.solve(normal, transposed @ vector)
    return solution + np.linalg.solve(normal, transposed @ (vector - matrix @ solution))
