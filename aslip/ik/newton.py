"""Newton's method on the equations of both legs, for all poses at once, from a geometric guess.

Every pose is solved on its own: no result depends on the poses it is solved with, nor on their
order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aslip.ik.equations import Equations
from aslip.ik.leg import (
    CRANK,
    FOOT,
    KNEE,
    PITCH,
    PLANTAR,
    ROLL,
    TARSUS,
    YAW,
    LegGeometry,
)
from aslip.ik.rotation import rotate, rotate_back

TOLERANCE = 1e-13
"""Largest residual of a solved pose [m, rad]: rounding leaves a few 1e-16."""

MAX_ITERATIONS = 20
"""Newton needs four steps for a pose of walking; many more tell that the target is out of reach."""

MAX_STEP = 0.3
"""Longest change of an angle in one step [rad]; the guess of a reachable pose is nearer."""


@dataclass(frozen=True)
class LegAngles:
    """Hinge angles of both legs, and whether they solve the equations."""

    angle: np.ndarray
    """(n, 2, 8) [rad]."""
    solved: np.ndarray
    """(n, 2) bool."""
    iterations: int
    """Newton steps of the slowest leg."""


def solve_legs(legs: LegGeometry, position: np.ndarray, rotation: np.ndarray) -> LegAngles:
    """Hinge angles that put the soles where they are wanted, whatever the joint limits.

    Args:
        legs: the geometry.
        position: (n, 2, 3), sole centres [m], pelvis frame.
        rotation: (n, 2, 3, 3), sole orientation, target to pelvis.
    """
    angle = guess(legs, position, rotation)
    iterations = 0
    while True:
        equations = Equations.at(legs, angle, position, rotation)
        unsolved = np.abs(equations.residual).max(axis=-1) > TOLERANCE
        if not unsolved.any() or iterations == MAX_ITERATIONS:
            return LegAngles(angle, ~unsolved, iterations)
        step = -_solve(equations.jacobian(), equations.residual)
        longest = np.abs(step).max(axis=-1, keepdims=True)
        step *= MAX_STEP / np.maximum(longest, MAX_STEP)
        # a solved leg is left alone, so that no pose depends on the others
        angle = np.where(unsolved[..., None], angle + step, angle)
        iterations += 1


def _solve(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Batched linear solution, 0 for the rare leg that is exactly singular."""
    try:
        return np.linalg.solve(matrix, vector[..., None])[..., 0]
    except np.linalg.LinAlgError:
        singular = np.linalg.det(matrix) == 0
        regular = np.where(singular[..., None, None], np.eye(matrix.shape[-1]), matrix)
        step = np.linalg.solve(regular, vector[..., None])[..., 0]
        return np.where(singular[..., None], 0, step)


def guess(legs: LegGeometry, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """(n, 2, 8) hinge angles near the solution: 0.01 rad for the motors, 0.1 rad for the rods.

    The rods nearly make parallelograms: the tarsus keeps its angle to the thigh, the crank its
    angle to the foot. What is left is a hip and two links in the plane of the leg, which the law of
    cosines solves. A target out of reach gets the straight leg.
    """
    toes = rotation[..., 0]
    angle = np.tile(legs.drawn, (len(position), 1, 1))
    hip = position - legs.translation[:, ROLL]
    angle[..., ROLL] = np.arctan2(hip[..., 1], -hip[..., 2])
    angle[..., YAW] = np.arctan2(toes[..., 1], toes[..., 0])
    frames = legs.frames(angle)
    sole, sole_to_pelvis = legs.sole_frame(frames)
    sole_to_ankle = rotate_back(sole_to_pelvis, frames.origin[FOOT] - sole)
    ankle = position + rotate(rotation, sole_to_ankle)

    # in the plane of the leg, as complex numbers; thigh and tarsus turn as one: a single link
    thigh_to_pelvis, hip = frames.rotation[PITCH], frames.origin[PITCH]
    wanted = _planar(thigh_to_pelvis, ankle - hip)
    shin = _planar(thigh_to_pelvis, frames.origin[TARSUS] - frames.origin[KNEE])
    thigh = _planar(thigh_to_pelvis, frames.origin[FOOT] - hip) - shin
    bend = (np.abs(wanted) ** 2 - np.abs(thigh) ** 2 - np.abs(shin) ** 2) / (
        2 * np.abs(thigh) * np.abs(shin)
    )
    drawn_bend = np.angle(shin / thigh)
    knee = np.sign(drawn_bend) * np.arccos(np.clip(bend, -1, 1)) - drawn_bend
    pitch = np.angle(wanted / (thigh + shin * np.exp(1j * knee)))
    drawn_toes = _planar(thigh_to_pelvis, sole_to_pelvis[..., 0])
    foot = np.angle(_planar(thigh_to_pelvis, toes) / drawn_toes * np.exp(-1j * pitch))
    for joint, turn in (
        (PITCH, pitch),
        (KNEE, knee),
        (TARSUS, -knee),
        (CRANK, foot),
        (PLANTAR, -foot),
        (FOOT, foot),
    ):
        angle[..., joint] += turn
    return angle


def _planar(thigh_to_pelvis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) in the plane of the leg as x + iy: a turn is a product."""
    x, y, _ = np.moveaxis(rotate_back(thigh_to_pelvis, vector), -1, 0)
    return x + 1j * y
