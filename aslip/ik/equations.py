r"""The equations of a leg, and their Jacobian.

Eight hinge angles of a leg meet eight equations:

====  ========================================================================================
rows  equation
====  ========================================================================================
0-2   the centre of the sole is at its target [m]
3-4   the toes point where the target's toes point: x axis of the sole in the target frame, y, z
5     the Achilles rod has its length: :math:`(|h - b|^2 - L^2) / 2L = 0` [m]
6-7   the plantar rod ends at its anchor on the foot: in the tarsus' plane of motion [m]
====  ========================================================================================

The Achilles rod turns freely about its ball, so its loop reduces to its length. The plantar loop is
planar: what is normal to the plane is constant, and zero by the rods' offsets. A leg has five
motors, hence no row for the roll of the sole about its own toe axis: it leans with the leg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aslip.ik.leg import (
    CHAIN,
    CRANK,
    FOOT,
    JOINTS,
    KNEE,
    PITCH,
    PLANTAR,
    TARSUS,
    Frames,
    LegGeometry,
)
from aslip.ik.rotation import cross, dot, rotate_back

POSITION = slice(0, 3)
TOES = slice(3, 5)
ACHILLES = 5
PLANTAR_LOOP = slice(6, 8)
LOOPS = slice(5, 8)

EQUATIONS = 8


@dataclass(frozen=True)
class Equations:
    """Residual of a leg's equations and what is needed for their Jacobian."""

    legs: LegGeometry
    angle: np.ndarray
    """(n, 2, 8) hinge angles [rad]."""
    frames: Frames
    target_rotation: np.ndarray
    """(n, 2, 3, 3) wanted sole orientation, target to pelvis."""
    toes: np.ndarray
    """(n, 2, 3) x axis of the sole, pelvis frame."""
    residual: np.ndarray
    """(n, 2, 8), rows as in the module's table."""

    @classmethod
    def at(
        cls, legs: LegGeometry, angle: np.ndarray, position: np.ndarray, rotation: np.ndarray
    ) -> Equations:
        """Evaluate the equations.

        Args:
            legs: the geometry.
            angle: (n, 2, 8), hinge angles [rad].
            position: (n, 2, 3), wanted sole centre [m], pelvis frame.
            rotation: (n, 2, 3, 3), wanted sole orientation, target to pelvis.
        """
        frames = legs.frames(angle)
        sole, sole_to_pelvis = legs.sole_frame(frames)
        rod, length = _rod(legs, frames), legs.rod_length
        toes = sole_to_pelvis[..., 0]
        residual = np.empty((*angle.shape[:-1], EQUATIONS))
        residual[..., POSITION] = sole - position
        residual[..., TOES] = rotate_back(rotation, toes)[..., 1:]
        residual[..., ACHILLES] = (dot(rod, rod) - length**2) / (2 * length)
        residual[..., PLANTAR_LOOP] = plantar_gap(legs, frames)[..., :2]
        return cls(legs, angle, frames, rotation, toes, residual)

    def toe_angle(self) -> np.ndarray:
        """(n, 2) angle between toes and where they should point [rad]; the residual is its sine."""
        return np.arctan2(np.linalg.norm(self.residual[..., TOES], axis=-1), self.toes_forward())

    def toes_forward(self) -> np.ndarray:
        """(n, 2) cosine of the same angle."""
        return dot(self.target_rotation[..., 0], self.toes)

    def toes_jacobian(self) -> np.ndarray:
        """(n, 2, 3, 8) derivative of the toes, in the target frame, with respect to the hinges."""
        jacobian = np.zeros((*self.toes.shape, len(JOINTS)))
        for joint in CHAIN:
            rate = cross(self.frames.axis(joint), self.toes)
            jacobian[..., joint] = rotate_back(self.target_rotation, rate)
        return jacobian

    def jacobian(self) -> np.ndarray:
        """(n, 2, 8, 8) derivative of the residual with respect to the hinge angles."""
        legs, frames = self.legs, self.frames
        jacobian = np.zeros((*self.residual.shape, len(JOINTS)))
        sole, _ = legs.sole_frame(frames)
        for joint in CHAIN:
            jacobian[..., POSITION, joint] = _turn(frames, joint, sole)
        jacobian[..., TOES, :] = self.toes_jacobian()[..., 1:, :]
        rod, heel = _rod(legs, frames), frames.point(TARSUS, legs.heel)
        for joint in (KNEE, TARSUS):
            rate = dot(rod, _turn(frames, joint, heel))
            jacobian[..., ACHILLES, joint] = rate / legs.rod_length
        end = frames.point(PLANTAR, legs.plantar_end)
        anchor = frames.point(FOOT, legs.plantar_anchor)
        for joint, point, sign in ((CRANK, end, 1), (PLANTAR, end, 1), (FOOT, anchor, -1)):
            rate = rotate_back(frames.rotation[TARSUS], sign * _turn(frames, joint, point))
            jacobian[..., PLANTAR_LOOP, joint] = rate[..., :2]
        return jacobian


def plantar_gap(legs: LegGeometry, frames: Frames) -> np.ndarray:
    """(n, 2, 3) from the plantar rod's anchor on the foot to the rod's end, tarsus frame [m]."""
    end = frames.point(PLANTAR, legs.plantar_end)
    anchor = frames.point(FOOT, legs.plantar_anchor)
    return rotate_back(frames.rotation[TARSUS], end - anchor)


def _rod(legs: LegGeometry, frames: Frames) -> np.ndarray:
    """(n, 2, 3) from the Achilles rod's ball to where it must end, pelvis frame [m]."""
    return frames.point(TARSUS, legs.heel) - frames.point(PITCH, legs.ball)


def _turn(frames: Frames, joint: int, point: np.ndarray) -> np.ndarray:
    """(n, 2, 3) velocity of a point when one hinge turns at unit rate [m/rad]."""
    return cross(frames.axis(joint), point - frames.origin[joint])


def achilles_rod(legs: LegGeometry, frames: Frames) -> np.ndarray:
    """(n, 2, 3) unit vector along the Achilles rod, in the frame of its ball joint at rest."""
    hip = rotate_back(frames.rotation[PITCH], _rod(legs, frames))
    rod = rotate_back(legs.ball_rotation, hip)
    return rod / np.linalg.norm(rod, axis=-1, keepdims=True)


def achilles_rod_rate(legs: LegGeometry, frames: Frames, rate: np.ndarray) -> np.ndarray:
    """(n, 2, 3) rate of `achilles_rod` for hinge rates (n, 2, 8) [rad/s]."""
    heel = frames.point(TARSUS, legs.heel)
    velocity = sum(
        (_turn(frames, joint, heel) * rate[..., joint, None] for joint in (KNEE, TARSUS)),
        start=np.zeros_like(heel),
    )
    hip = rotate_back(frames.rotation[PITCH], velocity)
    # normal to the rod but for rounding, since the rates keep its length
    return rotate_back(legs.ball_rotation, hip) / legs.rod_length[:, None]
