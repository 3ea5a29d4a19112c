"""Reward terms against values computed by hand, and their symmetries."""

import math
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

from aslip.planning import WalkState
from aslip.transforms import rewards
from aslip.transforms.rotation import conjugate, multiply, rotate_inverse

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0])


def _about(axis: tuple[float, float, float], angle: float) -> Tensor:
    unit = torch.tensor(axis) / math.hypot(*axis)
    return torch.cat([torch.tensor([math.cos(angle / 2)]), math.sin(angle / 2) * unit])


def _random(seed: int, num: int = 500) -> dict[str, Tensor]:
    """Inputs of all terms, from tiny to huge."""
    generator = torch.Generator().manual_seed(seed)

    def draw(size: int) -> Tensor:
        scale = 10 ** (4 * torch.rand(num, 1, generator=generator) - 3)
        return scale * torch.randn(num, size, generator=generator)

    names = ("velocity", "body", "position", "left", "right", "left_ref", "right_ref")
    inputs = {name: draw(3) for name in names}
    for name in ("orientation", "left_q", "right_q"):
        inputs[name] = torch.nn.functional.normalize(LEVEL + draw(4), dim=-1)
    inputs["action"], inputs["last_action"] = draw(10), draw(10)
    return inputs


def _terms(x: dict[str, Tensor]) -> dict[str, Tensor]:
    feet = (x["left"], x["right"], x["left_ref"], x["right_ref"])
    return {
        "com_vel": rewards.com_vel(x["orientation"], x["velocity"], x["body"]),
        "foot_pos": rewards.foot_pos(x["orientation"], x["position"], *feet),
        "straight_diff": rewards.straight_diff(x["position"]),
        "foot_orient": rewards.foot_orient(x["left_q"], x["right_q"]),
        "action_diff": rewards.action_diff(x["action"], x["last_action"]),
    }


# ----------------------------------------------------------------- by hand


def test_com_vel_is_compared_in_the_pelvis_frame() -> None:
    """A robot that faces left and moves left walks forward; facing ahead, it walks sideways."""
    left, forward = torch.tensor([0.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 0.0])
    facing_left = _about((0, 0, 1), math.pi / 2)
    assert rewards.com_vel(facing_left, left, forward).item() == pytest.approx(1.0)
    assert rewards.com_vel(LEVEL, left, forward).item() == pytest.approx(math.exp(-math.sqrt(2)))


def test_foot_pos_adds_the_distances_of_both_feet() -> None:
    left, right = torch.tensor([0.1, 0.1, -0.8]), torch.tensor([-0.1, -0.1, -0.9])
    body = torch.tensor([5.0, 2.0, 0.9])
    reward = rewards.foot_pos(
        LEVEL, body, body + left + torch.tensor([0.03, 0.0, 0.04]),
        body + right + torch.tensor([0.0, 0.1, 0.0]), left, right,
    )  # fmt: skip
    assert reward.item() == pytest.approx(math.exp(-0.15), rel=1e-5)


def test_straight_diff_has_no_dead_zone() -> None:
    for y in (0.0, 0.01, -0.04, 2.0):
        reward = rewards.straight_diff(torch.tensor([9.0, y, 0.8]))
        assert reward.item() == pytest.approx(math.exp(-abs(y)))


def test_foot_orient_costs_nine_percent_at_ten_degrees() -> None:
    """|q - 1| = 2 sin(angle / 4): 0.0872 for one foot at 10 degrees."""
    tilted = _about((0, 1, 0), math.radians(10))
    reward = rewards.foot_orient(tilted, LEVEL)
    assert reward.item() == pytest.approx(math.exp(-2 * math.sin(math.radians(2.5))), rel=1e-5)
    assert rewards.foot_orient(LEVEL, LEVEL).item() == 1.0
    both = rewards.foot_orient(tilted, tilted)
    assert both.item() == pytest.approx(reward.item() ** 2, rel=1e-5)


def test_action_diff_is_the_euclidean_distance() -> None:
    action, last = torch.zeros(10), torch.zeros(10)
    action[0], last[9] = 0.3, 0.4
    assert rewards.action_diff(action, last).item() == pytest.approx(math.exp(-0.5))
    assert rewards.action_diff(action, action).item() == 1.0


# ------------------------------------------------------------- properties


@pytest.mark.parametrize("seed", range(3))
def test_every_term_is_between_zero_and_one(seed: int) -> None:
    for name, reward in _terms(_random(seed)).items():
        assert reward.shape == (500, 1), name
        assert ((reward >= 0) & (reward <= 1)).all(), name
        assert reward.max() > 0.5, name  # some drawn states are good
        assert reward.min() < 0.1, name


def _turned(x: dict[str, Tensor], angle: float, names: tuple[str, ...]) -> dict[str, Tensor]:
    """Inputs with the whole robot rotated about the world's z axis."""
    yaw = _about((0, 0, 1), angle).expand(500, 4)
    turned = dict(x)
    turned["orientation"] = multiply(yaw, x["orientation"])
    for name in names:
        turned[name] = rotate_inverse(conjugate(yaw), x[name])
    return turned


@pytest.mark.parametrize("angle", [0.3, -2.0, math.pi])
def test_com_vel_and_foot_pos_do_not_depend_on_the_heading(angle: float) -> None:
    x = _random(4)
    for name in ("velocity", "body", "position", "left", "right", "left_ref", "right_ref"):
        x[name] = torch.nn.functional.normalize(x[name], dim=-1)
    turned = _turned(x, angle, ("velocity", "position", "left", "right"))
    for name in ("com_vel", "foot_pos"):
        torch.testing.assert_close(_terms(turned)[name], _terms(x)[name], atol=1e-4, rtol=0)


def test_foot_pos_does_not_depend_on_the_place_or_the_tilt() -> None:
    """Feet are compared in the yaw-aligned frame: a pitch alone costs nothing."""
    x = _random(5)
    for name in ("position", "left", "right", "left_ref", "right_ref"):
        x[name] = torch.nn.functional.normalize(x[name], dim=-1)
    x["orientation"] = LEVEL.expand(500, 4)
    moved = {**x, **{n: x[n] + torch.tensor([3.0, -2, 1]) for n in ("position", "left", "right")}}
    torch.testing.assert_close(_terms(moved)["foot_pos"], _terms(x)["foot_pos"])
    pitched = {**x, "orientation": _about((0, 1, 0), 0.4).expand(500, 4)}
    torch.testing.assert_close(_terms(pitched)["foot_pos"], _terms(x)["foot_pos"])


def _mirrored(x: dict[str, Tensor]) -> dict[str, Tensor]:
    """Inputs mirrored at the plane y = 0, with the legs swapped."""
    flip, turn = torch.tensor([1.0, -1, 1]), torch.tensor([1.0, -1, 1, -1])
    swap = {"left": "right", "right": "left", "left_ref": "right_ref", "right_ref": "left_ref"}
    swap |= {"left_q": "right_q", "right_q": "left_q"}
    mirrored = {}
    for name, value in x.items():
        source = x[swap.get(name, name)]
        if value.shape[-1] == 10:  # hip roll and yaw change sign
            signs = torch.tensor([-1.0, -1, 1, 1, 1])
            mirrored[name] = torch.cat([signs * source[:, 5:], signs * source[:, :5]], dim=-1)
        else:
            mirrored[name] = source * (turn if value.shape[-1] == 4 else flip)
    return mirrored


@pytest.mark.parametrize("name", list(rewards.PAPER_WEIGHTS))
def test_every_term_is_mirror_symmetric(name: str) -> None:
    x = _random(6)
    torch.testing.assert_close(_terms(_mirrored(x))[name], _terms(x)[name], atol=2e-5, rtol=1e-3)


# -------------------------------------------------------------------- on turns


def test_straight_ahead_terms_for_any_direction_are_the_papers_bit_for_bit() -> None:
    x, zero = _random(7), torch.zeros(500, 1)
    feet = (x["left"], x["right"], x["left_ref"], x["right_ref"])
    found = {
        "com_vel": rewards.com_vel(x["orientation"], x["velocity"], x["body"], zero),
        "foot_pos": rewards.foot_pos(x["orientation"], x["position"], *feet, zero),
        "foot_orient": rewards.foot_orient(x["left_q"], x["right_q"], zero, zero),
    }
    expected = _terms(x)
    for name, term in found.items():
        assert torch.equal(term, expected[name]), name


def test_path_diff_falls_with_the_distance_in_any_direction() -> None:
    error = torch.tensor([[0.0, 0.0], [0.1, 0.0], [0.06, -0.08], [-0.3, 0.0]])
    body = torch.tensor([0.02, -0.01, 0.9]).expand(4, 3)
    expected = torch.tensor([0.0, -1.0, -1.0, -3.0]).exp()[:, None]
    torch.testing.assert_close(rewards.path_diff(error + body[:, :2], body), expected)


def test_scales_of_terms_are_arguments() -> None:
    """A third of the scale takes the term to its third power."""
    error, body = torch.tensor([[0.03, 0.04]]), torch.zeros(1, 3)
    found = partial(rewards.path_diff, scale=0.1 / 3)(error, body)
    torch.testing.assert_close(found, rewards.path_diff(error, body) ** 3)
    orientation, heading = torch.tensor([[1.0, 0, 0, 0]]), torch.tensor([[0.05]])
    found = rewards.heading_diff(orientation, heading, scale=0.1 / 3)
    torch.testing.assert_close(found, rewards.heading_diff(orientation, heading) ** 3)
    one = torch.ones(1, 3)
    cases: list[tuple[Any, float, list[torch.Tensor]]] = [
        (rewards.power, 0.4, [torch.full((1, 10), 20.0), torch.zeros(1, 3)]),
        (rewards.landing, 0.6, [torch.full((1, 2), 500.0)]),
        (rewards.speed_diff, 0.3, [one, 1.2 * one]),
        (rewards.velocity_diff, 0.1, [orientation, one, 1.05 * one, one[:, :1] * 0]),
        (rewards.squeeze, 10.0, [torch.tensor([[[3.0, 4.0, 300.0], [-3.0, -4.0, 300.0]]])]),
    ]
    for term, scale, seen in cases:
        found = term(*seen, scale=scale / 3)
        assert 0 < found < 1
        torch.testing.assert_close(found, term(*seen) ** 3)


def test_power_is_seen_over_weight_and_speed() -> None:
    used = torch.tensor([[23.52, 0.0] * 5]).expand(3, 10)
    command = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.0], [0.0, -0.6, 0.0]])
    in_place = 117.6 / (33.312 * 9.81 * 0.4 * 0.4)
    expected = torch.tensor([in_place, in_place * 0.4, in_place * 0.4]).neg().exp()[:, None]
    torch.testing.assert_close(rewards.power(used, command), expected)


def test_landing_falls_with_the_force_on_the_foot_that_bears_more() -> None:
    weights = torch.tensor([[0.5, 0.5], [0.9, 0.0], [0.0, 1.2], [1.5, 0.2]])
    vertical = weights * 33.312 * 9.81
    expected = torch.tensor([0.0, 0.0, -0.5, -1.0]).exp()[:, None]
    torch.testing.assert_close(rewards.landing(vertical), expected)


def test_squeeze_falls_with_the_friction_that_feet_spend_against_each_other() -> None:
    """Not with vertical forces, nor with friction in one direction or on a single foot."""
    inward = torch.tensor([[0.0, 15.0, 160.0], [0.0, -15.0, 160.0]])
    alone = torch.tensor([[40.0, -30.0, 300.0], [0.0, 0.0, 0.0]])
    along = torch.tensor([[20.0, 10.0, 200.0], [10.0, 5.0, 100.0]])
    # 5 + 12 - 13 N
    across = torch.tensor([[5.0, 0.0, 160.0], [0.0, 12.0, 160.0]])
    expected = torch.tensor([-3.0, 0.0, 0.0, -0.4]).exp()[:, None]
    force = torch.stack([inward, alone, along, across])
    torch.testing.assert_close(rewards.squeeze(force), expected)


def test_heading_diff_falls_with_the_angle_between_pelvis_and_reference() -> None:
    """The shorter way around counts, and tilt does not."""
    turned = [_about((0, 0, 1), angle) for angle in (0.3, 0.2, 0.2, -3.1)]
    tilt = _about((1, 0, 0), 0.2)
    orientation = torch.stack([*turned[:3], multiply(turned[3], tilt)])
    heading = torch.tensor([0.3, 0.3, -0.1, 3.1])[:, None]
    angles = torch.tensor([0.0, 0.1, 0.3, 2 * math.pi - 6.2])[:, None]
    torch.testing.assert_close(
        rewards.heading_diff(orientation, heading), torch.exp(-angles / 0.1), atol=1e-5, rtol=1e-5
    )


def test_terms_do_not_depend_on_the_direction_of_the_reference() -> None:
    """Robot and reference turned together earn the same."""
    x, angle = _random(8, 50), torch.linspace(-2, 2, 50)[:, None]
    x = {name: value.double() for name, value in x.items()}
    half = angle.double() / 2
    turn = torch.cat([half.cos(), 0 * half, 0 * half, half.sin()], dim=-1)
    body = {name: rotate_inverse(conjugate(turn), x[name]) for name in ("body", "velocity")}
    turned = multiply(turn, x["orientation"])
    torch.testing.assert_close(
        rewards.com_vel(turned, body["velocity"], body["body"], 2 * half),
        rewards.com_vel(x["orientation"], x["velocity"], x["body"]),
    )
    feet = multiply(turn, x["left_q"]), multiply(turn, x["right_q"])
    torch.testing.assert_close(
        rewards.foot_orient(*feet, 2 * half, 2 * half),
        rewards.foot_orient(x["left_q"], x["right_q"]),
    )
    names = ("position", "left", "right", "left_ref", "right_ref")
    place, left, right, *target = (rotate_inverse(conjugate(turn), x[name]) for name in names)
    torch.testing.assert_close(
        rewards.foot_pos(turned, place, left, right, target[0], target[1], 2 * half),
        _terms(x)["foot_pos"],
    )


def test_toes_are_compared_with_those_of_the_reference() -> None:
    toes = _about((0, 0, 1), 0.3)
    angle = torch.tensor([0.3])
    assert rewards.foot_orient(toes, LEVEL, angle, 0 * angle).item() == pytest.approx(1)
    swapped = rewards.foot_orient(toes, LEVEL, 0 * angle, angle)
    assert swapped.item() == pytest.approx(math.exp(-4 * math.sin(0.075)), abs=1e-5)


def test_a_level_pelvis_is_one_with_its_axis_up() -> None:
    yaw, roll = _about((0, 0, 1), 1.0), _about((1, 0, 0), -0.1)
    both = torch.stack([yaw, multiply(yaw, roll)])
    found = rewards.level(both)[:, 0]
    torch.testing.assert_close(found, torch.tensor([1.0, math.exp(-math.sin(0.1) / 0.1)]))


def test_velocity_diff_is_compared_along_the_ground_from_either_heading() -> None:
    """A robot that tilts and bounces loses nothing."""
    turned = multiply(_about((0, 0, 1), 0.5), _about((0, 1, 0), 0.1))
    heading, ahead = torch.tensor([0.2]), torch.tensor([0.6, 0.1, 0.0])
    velocity = rotate_inverse(conjugate(_about((0, 0, 1), 0.5)), ahead + torch.tensor([0, 0, 0.4]))
    body = rotate_inverse(conjugate(_about((0, 0, 1), 0.2)), ahead)
    found = rewards.velocity_diff(turned, velocity, body, heading)
    assert found.item() == pytest.approx(1.0, abs=1e-5)
    slow = rewards.velocity_diff(turned, 0.9 * velocity, body, heading)
    assert slow.item() == pytest.approx(math.exp(-0.1 * math.hypot(0.6, 0.1) / 0.1), abs=1e-5)


def test_footstep_is_the_way_along_the_ground_from_where_the_foot_in_stance_should_be() -> None:
    feet = torch.tensor([[[0.3, 0.1, 0.0]], [[-0.2, -0.1, 0.0]]])
    for stance in (0, 1):
        aim = feet[stance] + torch.tensor([0.03, -0.04, 0.1])
        for since, side, away in (
            (0.2, 1.0, 0.05),
            (0.2, -1.0, 0.05),
            (0.02, 1.0, 0.0),  # lands in this policy step
            (0.2, 0.0, 0.0),  # follows no plan
        ):
            state = torch.zeros(1, WalkState.SIZE)
            state[0, -2:] = torch.tensor([stance, since])
            step = torch.tensor([[0.3, 0.1, 0.0, 0.2, side]])
            found = rewards.footstep(feet[0], feet[1], aim, state, step)
            expected = (math.exp(-away / 0.03) + 1 - away / 0.15) / 2
            assert found.item() == pytest.approx(expected, abs=1e-5)


def test_feet_are_compared_with_each_other_and_far_ones_count_nothing() -> None:
    one = torch.ones(1, 3)
    for away, expected in ((0.0, 1.0), (0.04, (math.exp(-1) + 0.8) / 2), (0.4, math.exp(-10) / 2)):
        left = one + torch.tensor([0.0, 0.6, 0.8]) * away
        found = rewards.feet_apart(left + 3.0, one + 3.0, one, one)
        assert found.item() == pytest.approx(expected, abs=1e-5)
        closer = one + (left - one) / 3
        scaled = rewards.feet_apart(closer + 3.0, one + 3.0, one, one, scale=0.04 / 3)
        torch.testing.assert_close(scaled, found, rtol=1e-4, atol=1e-5)


def test_touchdown_falls_with_load_in_flight_and_with_load_that_a_landed_foot_lacks() -> None:
    cases = [  # loads on stance and swing foot [weights], since, time to touchdown [s], follows
        (1.0, 0.0, 0.3, 0.2, True, 0.0),
        (1.0, 0.05, 0.3, 0.2, True, 0.05),
        (1.0, 0.05, 0.3, 0.02, True, 0.0),  # lands in this policy step
        (1.0, 0.05, 0.12, 0.2, True, 0.0),  # lifts off in it
        (1.0, -0.5, 0.3, 0.2, True, 0.0),  # is pushed down by the edge of a stone
        (0.0, 1.0, 0.05, 0.3, True, 0.1),
        (0.06, 1.0, 0.05, 0.3, True, 0.04),
        (0.0, 1.0, 0.02, 0.3, True, 0.0),  # has landed in it
        (0.0, 1.0, 0.3, 0.2, False, 0.0),
    ]
    for stance in (0, 1):
        for stood, swung, since, time, follows, missed in cases:
            load = [stood, swung] if stance == 0 else [swung, stood]
            force = torch.zeros(1, 2, 3)
            force[0, :, 2] = torch.tensor(load) * 33.312 * 9.81
            state = torch.zeros(1, WalkState.SIZE)
            state[0, -2:] = torch.tensor([stance, since])
            step = torch.tensor([[0.3, 0.1, 0.0, time, 2.0 * stance - 1 if follows else 0.0]])
            found = rewards.touchdown(force, state, step)
            assert found.item() == pytest.approx(math.exp(-missed / 0.1), abs=1e-4)
