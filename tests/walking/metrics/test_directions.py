"""Mean velocities and yaw rates of walks in all directions."""

import numpy as np
import pytest
import torch

from aslip.robot import CASSIE
from aslip.transforms.rotation import vertical_quaternion
from aslip.walking.metrics.directions import mean_twist, tracking_errors
from aslip.walking.record import frame_poses

STEPS = 101
TIME = np.arange(STEPS) * CASSIE.policy_period


def test_mean_velocities_and_the_turn_in_the_frame_add_up_to_the_twist() -> None:
    """One robot turns in the frame past half a turn, one keeps its yaw, and a third falls."""
    turn = np.array([1.3, 0.0, 0.5])
    yaw = torch.from_numpy(2.5 + TIME[:, None] * turn)
    orientation = vertical_quaternion(yaw[..., None]).numpy()
    speeds = np.array([[0.5, -0.2, 0.1], [-0.3, 0.1, 0.0], [0.0, 0.0, 0.0]])
    swing = np.sin(2 * np.pi * np.arange(STEPS) / STEPS)
    velocity = speeds + 0.2 * swing[:, None, None]
    velocity[60:, 2] = orientation[60:, 2] = np.nan
    twist = mean_twist(velocity, orientation, np.array([-0.4, 0.7, 0.0]))
    expected = [[0.5, -0.2, 0.9], [-0.3, 0.1, 0.7], [np.nan] * 3]
    np.testing.assert_allclose(twist, expected, rtol=0, atol=1e-6)


def test_errors_are_those_of_the_walks_that_did_not_fall() -> None:
    command = np.zeros((3, 3))
    twist = np.array([[0.03, -0.04, 0.02], [0.0, 0.1, -0.04], [np.nan] * 3])
    found = {name: one.mean for name, one in tracking_errors(twist, command).items()}
    assert found == pytest.approx(
        {"speed": 0.075, "speed_p95": 0.0975, "turn": 0.03, "turn_p95": 0.039}
    )
    none = tracking_errors(twist[2:], command[2:])
    assert np.isnan([one.mean for one in none.values()]).all()


def test_intervals_of_the_errors_are_over_commands() -> None:
    errors = np.random.default_rng(0).exponential(0.02, 200)
    twist = np.stack([errors, 0 * errors, -errors], axis=1)
    for name, one in tracking_errors(twist, np.zeros_like(twist)).items():
        middle = np.quantile(errors, 0.95) if name.endswith("p95") else errors.mean()
        assert one.mean == pytest.approx(middle)
        assert one.low < one.mean < one.high
        assert one.high - one.low < 0.6 * one.mean


def test_poses_of_a_frame_count_whole_turns() -> None:
    """The frame starts at a heading of 2 rad, and turns past half a turn, where headings wrap."""
    turned = 1.2 * TIME
    heading = np.angle(np.exp(1j * (2.0 + turned)))
    displacement = np.outer(TIME, [np.cos(2.0), np.sin(2.0)])  # along the first heading
    origin = np.column_stack([3.0 + displacement[:, 0], -1.0 + displacement[:, 1], 0 * TIME])
    pose = frame_poses(origin[:, None], heading[:, None, None])[:, 0]
    np.testing.assert_allclose(pose, np.column_stack([TIME, 0 * TIME, turned]), atol=1e-12)
