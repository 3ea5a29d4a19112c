"""The closed form of the pendulum solves its equation, and programs agree with it."""

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.planning import Pendulum, Planner, Program
from benchmarks.planning.planner import random_case

P = Pendulum()


@pytest.mark.parametrize("shift", [0.0, 0.07, 0.3])
def test_the_flow_solves_the_equation_of_motion(shift):
    body, velocity = np.array([[0.1, -0.05]]), np.array([[0.4, 0.3]])
    start, stance = np.array([[-0.2, 0.1]]), np.array([[0.1, -0.1]])
    start = start if shift else stance
    time = np.linspace(0, 0.5, 5001)
    body, velocity, start, stance = (
        np.repeat(one, len(time), axis=0) for one in (body, velocity, start, stance)
    )
    place, speed = P.flow(body, velocity, start, stance, np.full(len(time), shift), time)
    np.testing.assert_allclose(np.gradient(place, time, axis=0)[1:-1], speed[1:-1], atol=1e-5)
    share = np.clip(time / max(shift, 1e-9), 0, 1)[:, None]
    pressure = start + share * (stance - start)
    acceleration = P.rate**2 * (place - pressure)
    np.testing.assert_allclose(
        np.gradient(speed, time, axis=0)[1:-1], acceleration[1:-1], atol=3e-3
    )
    np.testing.assert_allclose((place[0], speed[0]), (body[0], velocity[0]), atol=1e-6)


def test_programs_predict_the_body_at_every_touchdown():
    """Bodies at touchdowns are those of the flow; for limits, up to a linearised time."""
    planner, rng = Planner(Program(Pendulum(bounce=0.0))), np.random.default_rng(0)
    for _ in range(5):
        case = random_case(planner.program, rng)
        problem = planner.program.problem(case.state, case.command)
        plan = planner.plan(case.state, case.command)
        for k, time in enumerate(plan.time[0]):
            before = plan.sample(np.array([time - 1e-9])).body
            np.testing.assert_allclose(before.position[0], plan.body[0][0, k + 1], atol=1e-6)
            np.testing.assert_allclose(before.velocity[0], plan.body[1][0, k + 1], atol=1e-6)
        steps = np.diff(plan.foothold[..., :2], axis=1, prepend=problem.stance[:, None, :2])
        variable = planner.program.variable(problem, plan.time[:, :1])[0]
        constant, by_time, by_step = planner.program.reach(problem)
        found = constant[0] + variable * by_time[0] + by_step @ steps[0]
        np.testing.assert_allclose(
            found, (plan.body[0][:, 1:] - plan.foothold)[0, :, :2], atol=0.01
        )
        cost = planner.program.value(planner.program.cost(problem), variable, steps)
        assert plan.cost == pytest.approx(cost, abs=1e-9)


def test_bodies_bounce_within_a_step():
    """The body is equally high at both touchdowns, and highest in single stance."""
    since, time = np.linspace(0, 0.4, 401), np.full(401, 0.4)
    height, rate, acceleration = P.bounced(since, time)
    np.testing.assert_allclose(np.gradient(height, since)[1:-1], rate[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(rate, since)[1:-1], acceleration[1:-1], atol=2e-2)
    assert height[0] == pytest.approx(height[-1])
    assert rate[-1] < -0.3
    assert since[height.argmax()] == pytest.approx(0.25, abs=0.01)
    # no step throws it into the air
    short = np.full(401, 0.2)
    assert (P.bounced(np.linspace(0, 0.2, 401), short)[2] > -P.gravity).all()


def test_constants_are_checked():
    with pytest.raises(ConfigurationError, match=r"double_stance must be .* 0\.36"):
        Pendulum(double_stance=0.4)
