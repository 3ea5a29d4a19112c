"""Plans are motions: smooth, periodic at a command, and continued without jumps."""

from dataclasses import replace

import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.planning import Plan, Planner
from benchmarks.planning.planner import random_case, standing

PLANNER = Planner()
PERIOD = 0.03


def _case(seed=0):
    return random_case(PLANNER.program, np.random.default_rng(seed))


def _walk(command, steps):
    """Plans of a pendulum that follows them."""
    state, plans = standing(PLANNER.program, 0), []
    for _ in range(steps):
        plans.append(PLANNER.plan(state, command))
        state = plans[-1].sample(np.array([PERIOD])).state()
    return plans


def test_replanned_walks_go_at_the_command_in_nominal_time():
    command = (0.5, -0.1, 0.0)
    plans = _walk(np.array([command]), 160)
    one, other = (plan.state.body_position[0, :2] for plan in (plans[-81], plans[-1]))
    np.testing.assert_allclose((other - one) / (80 * PERIOD), command[:2], atol=0.02)
    np.testing.assert_allclose(np.diff(plans[-1].time[0]), 0.4)
    whole = plans[-1].time[0, 0] + plans[-1].state.since[0]
    assert whole == pytest.approx(0.4, abs=0.01)


def test_turning_footholds_turn_with_the_heading():
    command = np.array([[0.5, 0.0, 0.4]])
    plan = PLANNER.plan(_walk(command, 30)[-1].state, command)
    sides = np.diff(plan.foothold[0, :, :2], axis=0)
    turned = np.array([[0.5 * np.cos(a), 0.5 * np.sin(a)] for a in plan.heading[0, 1:]])
    # heading is 0 at each plan, as the frame of its state
    assert ((sides * turned).sum(axis=1) > 0.5 * 0.15).all()
    np.testing.assert_allclose(np.diff(plan.heading[0]), 0.16)


def test_velocities_are_derivatives_and_feet_rest_in_contact():
    case = _case()
    plan = PLANNER.plan(case.state, case.command, case.stones)
    time = np.linspace(0, plan.time[0, -1], 8001)
    sample = plan.sample(time)
    # at touchdowns feet stop at once; a shorter step bounces faster, so that its rate jumps
    within = (np.diff(sample.contact, axis=0) == 0).all(axis=1)
    for track in (sample.body, sample.feet):
        middle = (track.velocity[1:] + track.velocity[:-1]) / 2
        steps = np.diff(track.position, axis=0) / np.diff(time).reshape(
            -1, *(1,) * (track.position.ndim - 1)
        )
        np.testing.assert_allclose(steps[within], middle[within], atol=5e-3)
    assert np.ptp(sample.foot_heading, axis=0).max() < 1
    assert np.abs(sample.feet.velocity[sample.contact]).max() < 1e-9
    assert sample.contact.any(axis=1).all() and not sample.contact.all()
    lifted = sample.feet.position[..., 2].max(axis=0) - plan.foothold[..., 2].max()
    assert (lifted > -0.01).all()
    weight = sample.ground_force.sum(axis=1)[:, 2]
    # it carries the body on average of whole steps, and never pulls it down
    whole = time >= plan.time[0, 0]
    carried = plan.pendulum.mass * plan.pendulum.gravity
    np.testing.assert_allclose(weight[whole].mean(), carried, rtol=1e-3)
    assert weight.min() > 0
    assert not np.any(sample.ground_force[~sample.contact])


def test_forces_point_from_the_centre_of_pressure_to_the_body():
    cases = [_case(seed) for seed in range(8)]
    plans = [PLANNER.plan(case.state, case.command, case.stones) for case in cases]
    for plan in plans:
        single = max(plan.pendulum.double_stance - plan.state.since[0], 0)
        sample = plan.sample(np.array([single + 1e-3]))
        stance, rate = sample.stance[0], plan.pendulum.rate
        toes = sample.foot_heading[0, stance]
        ahead = sample.pressure[0, stance] * np.array([np.cos(toes), np.sin(toes)])
        lever = sample.body.position[0, :2] - sample.feet.position[0, stance, :2] - ahead
        force = sample.ground_force[0].sum(0)[:2] / plan.pendulum.mass
        np.testing.assert_allclose(force, rate**2 * lever, atol=1e-9)
        assert sample.pressure[0, 1 - stance] == 0
    assert max(abs(plan.pressure).max() for plan in plans) > 0.02


def test_feet_land_on_their_footholds_in_time():
    case = _case(1)
    plan = PLANNER.plan(case.state, case.command, case.stones)
    for k, time in enumerate(plan.time[0]):
        sample = plan.sample(np.array([time - 1e-9, time]))
        side = (case.state.stance[0] + k + 1) % 2
        above = sample.feet.position[:, side] - plan.foothold[0, k]
        np.testing.assert_allclose(above, [[0, 0, above[0, 2]], [0, 0, 0]], atol=1e-6)
        # by what robots' feet are early
        assert 0.025 < above[0, 2] < 0.04
        # straight down, and at rest from then on
        speed = sample.feet.velocity[:, side]
        np.testing.assert_allclose(speed, [[0, 0, speed[0, 2]], [0, 0, 0]], atol=1e-4)
        assert -1.3 < speed[0, 2] < -0.5


def _in_flight() -> tuple[Plan, float]:
    case = _case(2)
    plan = PLANNER.plan(case.state, case.command)
    return plan, float(plan.time[0, 0]) - 0.12


def test_a_foot_goes_on_unchanged_from_a_state_of_its_own_path():
    plan, now = _in_flight()
    later = replace(plan, state=plan.sample(np.array([now])).state(), time=plan.time - now)
    for ahead in (0.0, 0.05, 0.1):
        one, two = plan.sample(np.array([now + ahead])), later.sample(np.array([ahead]))
        np.testing.assert_allclose(one.feet.position, two.feet.position, atol=1e-9)
        np.testing.assert_allclose(one.feet.velocity, two.feet.velocity, atol=1e-8)


def test_a_new_target_and_time_in_flight_change_no_position_and_velocity_at_once():
    plan, now = _in_flight()
    state = plan.sample(np.array([now])).state()
    other = replace(
        plan,
        state=state,
        time=plan.time - now + 0.04,
        foothold=plan.foothold + np.array([0.08, 0.05, 0.06]),
    )
    before, after = plan.sample(np.array([now])), other.sample(np.array([0.0]))
    np.testing.assert_allclose(before.feet.position, after.feet.position, atol=1e-12)
    np.testing.assert_allclose(before.feet.velocity, after.feet.velocity, atol=1e-12)


def test_states_name_an_array_of_the_wrong_shape():
    with pytest.raises(ShapeError, match=r"stance of a state must be \(1,\), got \(2,\)"):
        replace(_case().state, stance=np.zeros(2, dtype=int))
