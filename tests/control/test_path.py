"""A point that follows commands exactly gets onto the path and stays on it."""

import math

import numpy as np
import pytest

from aslip.control import Eight, PathFollower
from aslip.control.path import Pose


def _moved(pose: Pose, command: tuple[float, float, float], period: float) -> Pose:
    x, y, yaw = pose
    forward, sideways, rate = command
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return (
        x + period * (cosine * forward - sine * sideways),
        y + period * (sine * forward + cosine * sideways),
        yaw + period * rate,
    )


def test_a_figure_of_eight_is_two_circles_that_meet_at_the_origin() -> None:
    eight = Eight(2.0)
    distances = np.linspace(0, 8 * math.pi, 400, endpoint=False)
    places = np.array([eight.at(distance)[0] for distance in distances])
    for centre, half in ((2.0, places[:200]), (-2.0, places[200:])):
        radius = np.hypot(half[:, 0], half[:, 1] - centre)
        np.testing.assert_allclose(radius, 2.0, atol=1e-9)
    # tangents and arc length are those of the curve
    step = np.diff(places[:, :2], axis=0)
    np.testing.assert_allclose(np.linalg.norm(step, axis=1), distances[1], rtol=1e-3)
    tangent = np.arctan2(step[:, 1], step[:, 0]) - places[:-1, 2]
    assert np.abs(np.remainder(tangent + math.pi, math.tau) - math.pi).max() < 0.02
    assert [eight.at(distance)[1] for distance in (1.0, 4 * math.pi + 1.0)] == [0.5, -0.5]
    assert eight.at(8 * math.pi + 0.5)[0] == pytest.approx(eight.at(0.5)[0])


def test_a_point_beside_the_path_returns_to_it() -> None:
    follower, distance = PathFollower(Eight(3.0), 0.8), 0.0
    pose: Pose = (0.0, 0.3, 0.4)
    distances = []
    for _ in range(1600):
        command, distance = follower.command(pose, pose[2], distance)
        assert abs(command[1]) < 0.8
        pose = _moved(pose, command, 0.03)
        distances.append(abs(follower.errors(pose, distance)[1]))
    assert distances[0] > 0.25
    # 48 s are more than one round
    assert distance > 12 * math.pi
    assert max(distances[400:]) < 0.02


def test_speeds_are_commanded_in_the_frame_of_the_heading() -> None:
    """A robot whose heading is across the path walks sideways along it."""
    follower = PathFollower(Eight(1e6), 0.5)
    command, distance = follower.command((0.0, 0.0, math.pi / 2), math.pi / 2, 0.0)
    assert distance == pytest.approx(0.0)
    assert command == pytest.approx((0.0, -0.5, -math.pi / 2), abs=1e-5)
