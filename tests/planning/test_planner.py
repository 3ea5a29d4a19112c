"""Exact plans: optimal over stones, within the limits, honest where that is impossible."""

from dataclasses import replace

import numpy as np
import pytest

from aslip.errors import ConfigurationError, SolverError
from aslip.planning import BatchPlanner, Limits, Planner, Program, Stones, WalkState
from benchmarks.planning.planner import brute_force, random_case, standing

PLANNER = Planner()
LIMITS = PLANNER.program.limits
SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


def _cases(count, seed=0, stones=4):
    rng = np.random.default_rng(seed)
    return [random_case(PLANNER.program, rng, stones) for _ in range(count)]


def test_plans_are_as_good_as_brute_force_over_stones():
    complete = 0
    for case in _cases(60, stones=3):
        plan = PLANNER.plan(case.state, case.command, case.stones)
        least = brute_force(PLANNER, case)
        assert (plan.on_stones[0] == 4) == np.isfinite(least)
        if plan.on_stones[0] == 4:
            complete += 1
            assert plan.cost[0] == pytest.approx(least, abs=1e-6)
    assert complete > 20


def test_feet_stand_on_stones_within_limits():
    for case in _cases(20, seed=1):
        plan = PLANNER.plan(case.state, case.command, case.stones)
        stance = case.state.of_foot(case.state.foot_position, swing=False)
        points = np.concatenate([stance, plan.foothold[0]])
        for k, stone in enumerate(plan.stones[0, : plan.on_stones[0]]):
            place, toes = plan.foothold[0, k], plan.heading[:, k : k + 1]
            inner = case.stones.shrunk(toes, LIMITS.half_foot, LIMITS.margin)[0, 0, stone]
            assert (case.stones.normals[0, stone] @ place[:2] <= inner + 1e-6).all()
            assert place[2] == case.stones.heights[0, stone]
            assert abs(place[2] - points[k, 2]) <= LIMITS.rise
        if plan.within_limits[0]:
            _check_limits(case, plan, points)


def _check_limits(case, plan, points):
    time = plan.time[0]
    whole = time[0] + case.state.since[0]
    assert LIMITS.step_time[0] - 1e-9 <= whole <= LIMITS.step_time[1] + 1e-9
    for k, heading in enumerate(plan.heading[0]):
        side = 1 - 2 * ((case.state.stance[0] + k + 1) % 2)
        axes = np.array(
            [
                [np.cos(heading), np.sin(heading)],
                [-side * np.sin(heading), side * np.cos(heading)],
            ]
        )
        step = axes @ (points[k + 1] - points[k])[:2]
        for value, (low, high) in zip(step, (LIMITS.length, LIMITS.width), strict=True):
            assert low - 1e-6 <= value <= high + 1e-6
    foot = case.state.of_foot(case.state.foot_position, swing=True)[0]
    lifts = 0.1 - case.state.since[0]
    for begin, place in ((max(lifts, 0.0), foot), (lifts + 0.05, case.state.lift_off[0])):
        flight = time[0] - begin
        way = (points[1] - place)[:2] - case.state.body_velocity[0, :2] * flight
        # the limit is an octagon
        assert np.linalg.norm(way) <= LIMITS.foot_speed * flight / np.cos(np.pi / 8) + 1e-6


def test_a_push_ahead_is_answered_by_a_longer_and_sooner_step():
    case = _cases(1)[0]
    command = np.array([[0.4, 0.0, 0.0]])
    plain = PLANNER.plan(case.state, command)
    pushed = replace(
        case.state, body_velocity=case.state.body_velocity + np.array([[0.5, 0.0, 0.0]])
    )
    plan = PLANNER.plan(pushed, command)
    assert plan.foothold[0, 0, 0] > plain.foothold[0, 0, 0] + 0.05
    assert plan.time[0, 0] < plain.time[0, 0] - 0.02


@pytest.mark.parametrize("kind", [Planner, BatchPlanner])
def test_a_foot_in_flight_is_due_little_sooner_than_in_the_plan_before(kind):
    state = replace(_cases(1)[0].state, since=np.array([0.15]))
    pushed = replace(state, body_velocity=state.body_velocity + np.array([[1.0, 0.0, 0.0]]))
    command, sooner = np.array([[0.4, 0.0, 0.0]]), {}
    for limits in (LIMITS, replace(LIMITS, sooner=1.0)):
        planner = kind(Program(limits=limits))
        before = planner.plan(state, command)
        aim = np.concatenate([before.foothold[:, 0, :2], before.time[:, :1]], axis=1)
        after = planner.plan(pushed, command, aim=aim)
        sooner[limits.sooner] = before.time[0, 0] - after.time[0, 0]
    assert sooner[LIMITS.sooner] == pytest.approx(LIMITS.sooner, abs=1e-6)
    assert sooner[1.0] > 2 * LIMITS.sooner


def test_where_no_stone_is_in_reach_the_step_comes_near_and_the_plan_says_so():
    state, command = standing(PLANNER.program, 0), np.array([[0.3, 0.0, 0.0]])
    far = Stones.of([SQUARE + np.array([1.2, -0.2])], [0.0])
    plan = PLANNER.plan(state, command, far)
    assert plan.on_stones[0] == 0 and plan.within_limits[0] and plan.stones[0, 0] == -1
    free = PLANNER.plan(state, command)
    assert free.on_stones[0] == 4
    assert plan.foothold[0, 0, 0] > free.foothold[0, 0, 0] + 0.1
    one = PLANNER.plan(state, command, Stones.of([SQUARE + np.array([0.2, -0.2])], [0.0]))
    assert 1 <= one.on_stones[0] < 4


def test_beyond_all_limits_and_without_stones_there_is_a_plan_that_says_so():
    case = _cases(1)[0]
    gone = replace(case.stones, present=np.zeros((1, 4), dtype=bool))
    for stones in (None, case.stones, gone):  # without stones, robots are on the floor
        pushed = replace(case.state, body_velocity=np.array([[9.0, 0.0, 0.0]]))
        plan = PLANNER.plan(pushed, case.command, stones)
        assert not plan.within_limits[0]
        assert np.isfinite(plan.foothold).all()
    plan = PLANNER.plan(case.state, case.command, gone)
    assert plan.within_limits[0] and plan.on_stones[0] == 4
    with pytest.raises(SolverError, match=r"must be finite, those of robots \[0\] are not"):
        PLANNER.plan(replace(case.state, body_velocity=np.full((1, 3), np.nan)), case.command)


def test_a_solution_that_is_not_finite_is_none(monkeypatch):
    case = _cases(1)[0]
    nothing = np.full(10, np.nan)
    monkeypatch.setattr("daqp.solve", lambda *_: (nothing, np.nan, 1, {}))
    plan = PLANNER.plan(case.state, case.command, case.stones)
    assert not plan.within_limits[0]
    assert np.isfinite(plan.foothold).all()


def test_several_robots_are_planned_as_each_alone():
    cases = _cases(2)
    joined = type(cases[0].state)(
        **{
            name: np.concatenate([getattr(case.state, name) for case in cases])
            for name in vars(cases[0].state)
        }
    )
    command = np.concatenate([case.command for case in cases])
    plan = PLANNER.plan(joined, command)
    for i, case in enumerate(cases):
        alone = PLANNER.plan(case.state, case.command)
        np.testing.assert_allclose(plan.foothold[i], alone.foothold[0], atol=1e-9)
    at = plan.sample(np.array([0.1, 0.2]))
    np.testing.assert_allclose(
        at.body.position[1], alone.sample(np.array([0.2])).body.position[0], atol=1e-9
    )


def test_a_robot_without_stones_plans_as_on_the_floor_beside_others_on_stones():
    cases = _cases(2)
    state = WalkState.from_rows(np.concatenate([case.state.to_rows() for case in cases]))
    command = np.concatenate([case.command for case in cases])
    given = {name: np.concatenate([value] * 2) for name, value in vars(cases[0].stones).items()}
    given["present"][1] = False
    plan = PLANNER.plan(state, command, Stones(**given))
    for i, stones in enumerate((cases[0].stones, None)):
        alone = PLANNER.plan(cases[i].state, cases[i].command, stones)
        np.testing.assert_allclose(plan.foothold[i], alone.foothold[0], atol=1e-9)
        np.testing.assert_allclose(plan.time[i], alone.time[0], atol=1e-9)
        np.testing.assert_allclose(plan.pressure[i], alone.pressure[0], atol=1e-9)


def test_swing_feet_have_a_limit_of_speed_of_their_own_on_the_floor():
    slow = Planner(Program(limits=Limits(floor_speed=1.5)))
    for case in _cases(3)[1:]:  # walks at 0.9 and 1 m/s
        plan, late = (planner.plan(case.state, case.command) for planner in (PLANNER, slow))
        assert late.time[0, 0] > plan.time[0, 0] + 0.04
        given = (case.state, case.command, case.stones)
        np.testing.assert_array_equal(slow.plan(*given).time, PLANNER.plan(*given).time)


@pytest.mark.parametrize("planner", [PLANNER, BatchPlanner(PLANNER.program)])
def test_a_foothold_on_the_floor_is_displaced_as_far_as_the_limits_allow(planner):
    state, command = standing(PLANNER.program, 0), np.array([[0.3, 0.0, 0.0]])
    free = planner.plan(state, command).foothold[0, 0, :2]
    # the right foot comes no nearer to the left one than the limit
    near = np.array([free[0], -LIMITS.width[0]])
    shift = np.array([0.1, -0.05])
    for moved, expected in ((shift, free + shift), (np.array([0.0, 0.5]), near)):
        plan = planner.plan(state, command, shift=moved[None])
        np.testing.assert_allclose(plan.foothold[0, 0, :2], expected, atol=1e-3)


def test_the_batched_form_is_optimal_without_stones_and_near_it_with_them():
    batch, gaps, same = BatchPlanner(PLANNER.program), [], []
    for case in _cases(40, seed=2):
        for stones in (None, case.stones):
            exact, rough = (
                planner.plan(case.state, case.command, stones) for planner in (PLANNER, batch)
            )
            if stones is None:
                gaps.append(np.abs(exact.foothold - rough.foothold).max())
            elif exact.on_stones[0] == 4:
                same.append(exact.stones[0, 0] == rough.stones[0, 0])
    assert np.median(gaps) < 1e-6
    assert np.mean(same) > 0.7


def test_the_batched_form_takes_tensors():
    import torch

    case = _cases(1)[0]
    batch = BatchPlanner(PLANNER.program)
    state, stones = (
        {name: torch.as_tensor(value) for name, value in vars(one).items()}
        for one in (case.state, case.stones)
    )
    state, stones = WalkState(**state), Stones(**stones)
    for given in (None, stones):
        found = batch.plan(state, torch.as_tensor(case.command), given)
        expected = batch.plan(case.state, case.command, given and case.stones)
        np.testing.assert_allclose(found.foothold.numpy(), expected.foothold, atol=1e-9)
        time = np.array([0.13])
        one, two = found.sample(torch.as_tensor(time)), expected.sample(time)
        np.testing.assert_allclose(one.feet.position.numpy(), two.feet.position, atol=1e-9)
        np.testing.assert_allclose(one.ground_force.numpy(), two.ground_force, atol=1e-6)


@pytest.mark.parametrize(
    ("polygons", "heights", "message"),
    [
        ([], [], "one or more, got 0 polygons"),
        ([SQUARE], [0.0, 1.0], "1 polygons and 2 heights"),
        ([SQUARE[:2]], [0.0], r"stone 0 must have three or more corners"),
        ([SQUARE, SQUARE[[0, 2, 1, 3]]], [0.0, 0.0], "stone 1 must be convex"),
        ([SQUARE * [1, np.nan]], [0.0], "stone 0 must be finite"),
        ([SQUARE[[0, 1, 2, 2]]], [0.0], "stone 0 has two equal corners"),
        ([SQUARE], [np.inf], "heights of stones must be finite"),
    ],
)
def test_bad_stones_are_named(polygons, heights, message):
    with pytest.raises(ConfigurationError, match=message):
        Stones.of(polygons, heights)


def test_corners_of_stones_are_on_their_edges():
    """Either order of corners, and fewer of them than others have."""
    stones = Stones.of([SQUARE[::-1], SQUARE[:3] + 1.0], [0.1, 0.2])
    distance = np.einsum("nmek,nmck->nmec", stones.normals, stones.corners)
    distance -= stones.offsets[..., None]
    assert distance.max() < 1e-12 and distance.min() < -0.1
    assert (np.isclose(distance, 0).sum(axis=-1) >= 2).all()


def test_robots_step_on_a_stone_whose_corners_are_far_away():
    (case,), stones = _cases(1), Stones.of([40 * SQUARE], [0.0])
    for planner in (PLANNER, BatchPlanner(PLANNER.program)):
        assert planner.plan(case.state, case.command, stones).on_stones.tolist() == [4]


def test_a_whole_foot_stands_on_what_is_left_of_a_stone():
    stones = Stones.of([SQUARE, 0.5 * SQUARE], [0.0, 0.0])
    toes = np.array([[0.0, np.pi / 2]])
    shrunk = stones.shrunk(toes, half_length=0.08, margin=0.01)[0]
    # edges of the square look along -y, x, y, -x
    np.testing.assert_allclose(shrunk[0, 0], [0.09, 0.01, 0.09, 0.01])
    np.testing.assert_allclose(shrunk[1, 0], [0.01, 0.09, 0.01, 0.09])
    # the centre of a foot that is too long may be near that of the stone
    np.testing.assert_allclose(shrunk[0, 1], [0.04, 0.005, 0.04, 0.005])
    half = stones.shrunk(toes, half_length=0.08, margin=0.01, share=0.5)[0]
    np.testing.assert_allclose(half, shrunk / 2, atol=1e-12)
    # a platform keeps no more than a stone
    large = Stones.of([10 * SQUARE], [0.0])
    whole, half = (large.shrunk(toes, 0.08, 0.01, share) for share in (1.0, 0.5))
    np.testing.assert_allclose(whole - half, 0.05, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", (0.2, 0.1)),
        ("width", 0.3),
        ("foot_speed", 0.0),
        ("rise", np.nan),
        ("rise", (0, 1)),
    ],
)
def test_bad_limits_are_named(name, value):
    with pytest.raises(ConfigurationError, match=name):
        Limits(**{name: value})


def test_a_program_needs_two_steps_and_a_part_of_each_stone():
    with pytest.raises(ConfigurationError, match=r"reserve must be .* from 0 to 0\.25"):
        Program(limits=Limits(reserve=0.5))
    with pytest.raises(ConfigurationError, match="steps must be a whole number of 2 or more"):
        Program(steps=1)
