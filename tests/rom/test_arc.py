"""Mean paths of motions are arcs of constant twist."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aslip.rom.arc import twist_pose

TWIST = np.array([0.7, -0.2, 0.9])
TIME = np.linspace(-2.0, 3.0, 11)


def test_frame_moves_at_its_twist():
    """Integral of the twist, from the origin."""

    def rate(_, pose):
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        forward, sideways, yaw_rate = TWIST
        return [cosine * forward - sine * sideways, sine * forward + cosine * sideways, yaw_rate]

    path = solve_ivp(rate, (0.0, 3.0), np.zeros(3), t_eval=TIME[TIME >= 0], rtol=1e-10, atol=1e-12)
    pose = twist_pose(TWIST, path.t)
    np.testing.assert_allclose(pose.position[:, :2], path.y[:2].T, atol=1e-9)
    np.testing.assert_allclose(pose.angle, path.y[2], atol=1e-9)


def test_slow_turns_approach_the_straight_line():
    turning = twist_pose(np.array([0.7, -0.2, 1e-9]), TIME)
    np.testing.assert_allclose(turning.position, np.outer(TIME, [0.7, -0.2, 0.0]), atol=1e-8)


@pytest.mark.parametrize("size", [1, 2])
def test_missing_numbers_of_a_command_are_zero(size):
    full = np.r_[TWIST[:size], np.zeros(3 - size)]
    short = twist_pose(TWIST[:size], TIME)
    np.testing.assert_array_equal(short.position, twist_pose(full, TIME).position)
    np.testing.assert_array_equal(short.angle, 0.0)


def test_poses_along_the_arc_compose():
    point = np.random.default_rng(0).standard_normal((len(TIME), 2, 3))
    later = twist_pose(TWIST, np.full(len(TIME), 0.4)).transform(point)
    both = twist_pose(TWIST, TIME + 0.4).transform(point)
    np.testing.assert_allclose(twist_pose(TWIST, TIME).transform(later), both, atol=1e-14)


def test_inverse_undoes_a_pose():
    pose = twist_pose(TWIST, TIME)
    point = np.random.default_rng(0).standard_normal((len(TIME), 3))
    np.testing.assert_allclose(pose.inverse().transform(pose.transform(point)), point, atol=1e-14)
