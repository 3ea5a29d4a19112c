"""Footsteps of a made-up walk."""

import numpy as np
import pytest

from aslip.walking.metrics import Footsteps, footsteps, placement

PERIOD = 0.03
STRIDE = 0.8
DUTY = 0.6


def walk(
    step: float, width: float, slip: float = 0.0, duration: float = 8.0
) -> tuple[np.ndarray, np.ndarray]:
    """Forces and feet of a walk with known steps; feet may slide forward while they stand [m/s]."""
    time = np.arange(round(duration / PERIOD)) * PERIOD
    force, foot = np.zeros((len(time), 2)), np.zeros((len(time), 2, 3))
    for i in range(2):
        phase = (time + 0.3 - i * STRIDE / 2) / STRIDE
        number, share = np.floor(phase), phase % 1
        standing = share < DUTY
        force[:, i] = np.where(standing, 300.0, 0.0)
        place = (2 * number + i) * step
        middle = slip * (share - DUTY / 2) * STRIDE
        swing = (share - DUTY) / (1 - DUTY)
        foot[:, i, 0] = place + np.where(standing, middle, 2 * step * swing)
        foot[:, i, 1] = (0.5 - i) * width
        foot[:, i, 2] = np.where(standing, 0.0, 0.1)
    return force, foot


def test_footsteps_in_order_of_touchdown() -> None:
    steps = footsteps(*walk(0.4, 0.2), PERIOD)
    assert (np.diff(steps.side) != 0).all()
    np.testing.assert_allclose(np.diff(steps.position[:, 0]), 0.4, atol=1e-9)
    np.testing.assert_allclose(steps.position[:, 1], np.where(steps.side == 0, 0.1, -0.1))
    np.testing.assert_allclose(np.diff(steps.time), STRIDE / 2, atol=PERIOD)


def test_placement_in_a_turn_compares_steps_in_the_heading() -> None:
    """A walk at 0.2 rad/s, whose world is turned by 1 rad, has the errors of the straight walk."""
    force, foot = walk(0.35, 0.23)
    straight = placement(footsteps(force, foot, PERIOD), np.array([[0.4, 0.2], [0.4, -0.2]]))
    steps = footsteps(force, foot, PERIOD)
    heading = 1.0 + 0.2 * np.arange(len(force)) * PERIOD
    yaw = heading[np.rint(steps.time / PERIOD).astype(int)]
    moves = np.diff(steps.position, axis=0)
    cosine, sine = np.cos(yaw[1:]), np.sin(yaw[1:])
    turned = np.stack(
        [cosine * moves[:, 0] - sine * moves[:, 1], sine * moves[:, 0] + cosine * moves[:, 1]], 1
    )
    places = np.concatenate([np.zeros((1, 2)), turned.cumsum(axis=0)])
    found = placement(
        Footsteps(steps.side, steps.time, places, yaw), np.array([[0.4, 0.2], [0.4, -0.2]])
    )
    np.testing.assert_allclose(found.offset, straight.offset, atol=1e-12)
    np.testing.assert_array_equal(footsteps(force, foot, PERIOD, heading=heading).heading, yaw)


@pytest.mark.parametrize(("short", "wide"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.03), (-0.02, 0.04)])
def test_placement_error_is_actual_minus_ideal(short: float, wide: float) -> None:
    steps = footsteps(*walk(0.4 - short, 0.2 + wide), PERIOD)
    found = placement(steps, np.array([[0.4, 0.2], [0.4, -0.2]]))
    assert len(found.error) == len(steps.side) - 1
    np.testing.assert_allclose(found.offset[:, 0], -short, atol=1e-9)
    np.testing.assert_allclose(found.outward, wide, atol=1e-9)
    np.testing.assert_allclose(found.width, 0.2 + wide, atol=1e-9)
    np.testing.assert_allclose(found.error, np.hypot(short, wide), atol=1e-9)


def test_consecutive_stances_of_one_foot_are_not_a_step() -> None:
    side = np.array([0, 1, 1, 0])
    steps = Footsteps(side, np.arange(4.0), np.zeros((4, 2)), np.zeros(4))
    assert placement(steps, np.zeros((2, 2))).side.tolist() == [1, 0]


def test_standing_robot_has_no_footsteps() -> None:
    steps = footsteps(np.full((50, 2), 160.0), np.zeros((50, 2, 3)), PERIOD)
    assert len(steps.side) == 0
    assert len(placement(steps, np.zeros((2, 2))).error) == 0
