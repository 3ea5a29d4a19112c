"""Every derivative that is written by hand agrees with finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from aslip.ik.equations import Equations, achilles_rod, achilles_rod_rate
from aslip.ik.rotation import (
    quaternion_to_matrix,
    rotate,
    shortest_rotation,
    shortest_rotation_rate,
)

STEP = 1e-6


@pytest.fixture
def angle(kinematics) -> np.ndarray:
    """(20, 2, 8) hinge angles within the limits, loops open."""
    rng = np.random.default_rng(3)
    legs = kinematics.legs
    lower, upper = np.maximum(legs.lower, -3), np.minimum(legs.upper, 3)
    return rng.uniform(lower, upper, (20, 2, 8))


def _unit(array: np.ndarray) -> np.ndarray:
    return array / np.linalg.norm(array, axis=-1, keepdims=True)


def test_jacobian_of_the_leg_equations(kinematics, angle):
    rng = np.random.default_rng(4)
    position = rng.normal(size=(20, 2, 3))
    rotation = quaternion_to_matrix(_unit(rng.normal(size=(20, 2, 4))))
    jacobian = Equations.at(kinematics.legs, angle, position, rotation).jacobian()
    for joint in range(angle.shape[-1]):
        step = STEP * np.eye(angle.shape[-1])[joint]
        ahead, behind = (
            Equations.at(kinematics.legs, moved, position, rotation).residual
            for moved in (angle + step, angle - step)
        )
        numeric = (ahead - behind) / (2 * STEP)
        np.testing.assert_allclose(jacobian[..., joint], numeric, atol=1e-8)


def test_rate_of_the_achilles_rod_along_motions_that_keep_its_length(kinematics, angle):
    legs = kinematics.legs
    rng = np.random.default_rng(5)
    rate = rng.normal(size=angle.shape)
    frames = legs.frames(angle)
    ahead, behind = (
        achilles_rod(legs, legs.frames(angle + sign * STEP * rate)) for sign in (1, -1)
    )
    numeric = (ahead - behind) / (2 * STEP)
    rod = achilles_rod(legs, frames)
    analytic = achilles_rod_rate(legs, frames, rate)
    # with loops open the rod stretches: compare what is normal to it, at its present length
    ball = frames.point(2, legs.ball)
    length = np.linalg.norm(frames.point(4, legs.heel) - ball, axis=-1, keepdims=True)
    analytic = analytic * legs.rod_length[:, None] / length
    analytic -= np.sum(analytic * rod, axis=-1, keepdims=True) * rod
    np.testing.assert_allclose(analytic, numeric, atol=1e-8)


def test_shortest_rotation_turns_one_vector_into_the_other_without_twist():
    rng = np.random.default_rng(6)
    start, end = _unit(rng.normal(size=(2, 100, 3)))
    quaternion = shortest_rotation(start, end)
    np.testing.assert_allclose(rotate(quaternion_to_matrix(quaternion), start), end, atol=1e-12)
    np.testing.assert_allclose(np.sum(quaternion[:, 1:] * start, axis=1), 0, atol=1e-15)


def test_rate_of_the_shortest_rotation():
    rng = np.random.default_rng(7)
    start = np.tile(_unit(rng.normal(size=3)), (100, 1))
    end = _unit(start + 0.5 * rng.normal(size=(100, 3)))
    rate = np.cross(rng.normal(size=(100, 3)), end)
    omega = shortest_rotation_rate(start, end, rate)
    ahead, behind = (
        quaternion_to_matrix(shortest_rotation(start, _unit(end + sign * STEP * rate)))
        for sign in (1, -1)
    )
    here = quaternion_to_matrix(shortest_rotation(start, end))
    spin = (ahead - behind) / (2 * STEP) @ np.swapaxes(here, 1, 2)
    numeric = np.stack((spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]), axis=1)
    np.testing.assert_allclose(omega, numeric, atol=1e-8)
