"""Path of a command: arcs, origins on slopes, distances."""

import math

import numpy as np
import pytest
import torch

from aslip.library import WalkMode
from aslip.rom.arc import twist_pose
from aslip.transforms.path import (
    LEASH,
    LEASH_TIME,
    advance_frame,
    advance_heading,
    dragged,
    move_origin,
    place_in_path,
)
from aslip.transforms.rotation import heading_to_world, rotate_about_vertical, rotate_inverse

PERIOD = 0.03


@pytest.mark.parametrize("command", [(1.0, 0.3, 0.9), (0.5, 0.0, 0.0), (0.0, 0.0, -1.5)])
def test_origin_and_heading_follow_the_twist_of_the_command(
    command: tuple[float, float, float],
) -> None:
    """100 policy steps end where the model's motion ends, for a pelvis above the origin."""
    twist = torch.tensor([command], dtype=torch.float64)
    heading = torch.zeros(1, 1, dtype=torch.float64)
    origin = torch.zeros(1, 3, dtype=torch.float64)
    above = torch.zeros(1, 2, dtype=torch.float64)
    for _ in range(100):
        origin, heading = advance_frame(origin, heading, twist, above)
    expected = twist_pose(np.array(command), np.array([100 * PERIOD]))
    zero = np.zeros((1, 3))
    np.testing.assert_allclose(origin, expected.transform(zero), atol=1e-12)
    turned = np.angle(np.exp(1j * expected.angle))
    np.testing.assert_allclose(heading[:, 0], turned, atol=1e-12)


@pytest.mark.parametrize("heading", [-3.1, 0.0, 300.0])
def test_slow_turns_add_up_in_single_precision(heading: float) -> None:
    """The heading stays within half a turn, so that slow turns count after many turns, too."""
    angle, command = torch.tensor([[heading]]), torch.tensor([[0.0, 0.0, 0.02]])
    for _ in range(1000):
        angle = advance_heading(angle, command)
    assert angle.abs() <= math.pi + 1e-6
    turned = math.remainder(float(angle) - heading, math.tau)
    assert turned == pytest.approx(1000 * PERIOD * 0.02, rel=1e-3)


def test_a_pelvis_at_rest_in_the_frame_has_the_commanded_velocity() -> None:
    """Wherever it is in the frame: its path is the model's, and the origin swings around it."""
    twist = torch.tensor([[1.0, 0.3, 0.9]] * 3, dtype=torch.float64)
    heading = torch.zeros(3, 1, dtype=torch.float64)
    error = torch.tensor([[0.0, 0.0], [-0.2, 0.1], [0.3, 0.0]], dtype=torch.float64)
    level = torch.nn.functional.pad(error, (0, 1))
    pelvis = torch.ones(3, 3, dtype=torch.float64)
    origin = pelvis - level
    for _ in range(100):
        origin, heading = advance_frame(origin, heading, twist, error)
    pelvis = origin + rotate_about_vertical(level, heading)
    expected = twist_pose(twist[0].numpy(), np.array([100 * PERIOD])).transform(np.zeros((1, 3)))
    np.testing.assert_allclose(pelvis[:, :2], 1 + expected.repeat(3, axis=0)[:, :2], atol=1e-12)


def test_on_a_slope_the_origin_stays_on_the_floor_below_the_way() -> None:
    slope, heading = torch.full((1, 1), 0.1), torch.full((1, 1), 0.7)
    displacement = torch.tensor([[0.2, -0.1, 0.0]])
    origin = move_origin(torch.zeros(1, 3), heading, displacement, slope)
    assert origin[0, 2].abs() < 1e-7
    seen = rotate_inverse(heading_to_world(slope, heading), origin)
    torch.testing.assert_close(seen[:, :2], displacement[:, :2])


def test_a_pelvis_far_from_the_origin_drags_it_along() -> None:
    place = torch.tensor([[0.03, -0.02, 0.9], [3.0, 4.0, 0.9]])
    heading = torch.full((2, 1), math.pi / 2)
    entries = {"pelvis_position": place, "pelvis_velocity": torch.ones(2, 3)}
    found = place_in_path(entries, torch.ones(2, 3) * torch.tensor([1, 1, 0]), heading)
    assert torch.equal(found["pelvis_position"][0], place[0])
    displacement = (5 - LEASH) * PERIOD / LEASH_TIME
    expected = torch.tensor([[0.03, -0.02], [0.6 * (5 - displacement), 0.8 * (5 - displacement)]])
    torch.testing.assert_close(found["path_error"], expected)
    assert torch.equal(found["pelvis_position"][:, 2], place[:, 2])
    assert torch.equal(found["pelvis_velocity"], entries["pelvis_velocity"])
    # the frame's x is the world's y
    moved = displacement * torch.tensor([-0.8, 0.6, 0.0])
    expected = torch.stack([torch.zeros(3), moved]) + torch.tensor([1.0, 1.0, 0.0])
    torch.testing.assert_close(found["origin"], expected)
    assert torch.equal(dragged(place[:1]), torch.zeros(1, 3))


def test_the_distance_from_the_path_tells_the_error_of_the_velocity() -> None:
    """It settles at the leash's length and what the error adds in its time constant."""
    lag = torch.tensor([[0.05], [0.3]])
    error = torch.zeros(2, 3)
    for _ in range(round(12.0 / PERIOD)):
        error[:, :1] -= lag * PERIOD
        error -= dragged(error)
    expected = LEASH + lag[:, 0] * (LEASH_TIME - PERIOD)
    torch.testing.assert_close(-error[:, 0], expected, atol=2e-3, rtol=0)


def test_stops_bring_the_origin_below_the_pelvis() -> None:
    place = torch.tensor([[0.1, -0.2, 0.9], [0.0, 0.0, 0.9], [0.1, -0.2, 0.9], [3.0, 4.0, 0.9]])
    modes = [WalkMode.STOP, WalkMode.STOP, WalkMode.STAND, WalkMode.START]
    mode = torch.tensor(modes, dtype=torch.float32)[:, None]
    found = place_in_path({"pelvis_position": place}, place * 0, torch.zeros(4, 1), mode=mode)
    assert torch.equal(found["path_error"][:2], torch.zeros(2, 2))
    assert torch.equal(found["origin"][:2, :2], place[:2, :2])
    walking = place_in_path({"pelvis_position": place}, place * 0, torch.zeros(4, 1))
    for name, value in found.items():
        assert torch.equal(value[2:], walking[name][2:]), name
