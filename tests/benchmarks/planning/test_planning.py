"""Benchmarks of the planner recover what is known."""

import numpy as np
import pytest
import torch

import aslip
from aslip.envs.directions import course_stack, planned_stack
from aslip.errors import UnknownNameError
from aslip.planning import BatchPlanner, Pendulum
from aslip.policy import load_policy
from aslip.sim.course import random_stones, stairs
from aslip.transforms.plan_state import footholds_in_world
from aslip.transforms.planned import default_planner
from aslip.walking import Walks
from aslip.walking.record import commands_kept
from benchmarks.common import Subject
from benchmarks.planning import followed, models, planner, stepping_stones


def test_models_are_exact_on_steps_of_a_pendulum():
    rng, pendulum = np.random.default_rng(0), Pendulum(rate=2.0)
    now, last = rng.normal(0, 0.2, (20, 2, 2)), rng.normal(0, 0.2, (20, 2))
    time = np.full(20, 0.4)
    later = pendulum.flow(
        now[:, 0], now[:, 1], last, 0 * last, np.full(20, pendulum.double_stance), time
    )
    steps = models.Steps(np.arange(20), time, last, now, np.stack(later, axis=1))
    fitted = models.map_model(steps.fitted(steps.walk % 2 == 0))
    for model in (models.pendulum_model(2.0), fitted):
        np.testing.assert_allclose(model(steps), steps.later, atol=1e-9)
    assert np.abs(models.pendulum_model(3.0)(steps) - steps.later).max() > 0.05


def test_plans_alone_cross_stones_unless_noise_throws_them_off():
    stones = random_stones(np.random.default_rng(0), 2, count=4, difficulty=0.0)
    config, exact = followed.Config(seconds=6.0), default_planner()
    assert followed.followed(exact, stones, 0.0, config).all()
    planned = BatchPlanner(exact.program)  # greedy, so that it is lost on some courses
    assert followed.followed(planned, stones, 0.0, config).any()
    assert not followed.followed(planned, stones, 0.1, config).any()


def _gliding_walk() -> Walks:
    """A body at 1 m/s along y, feet that touch down in turn, and a frame turned by 90 degrees."""
    m, up = 60, np.arange(60) % 24
    flat, arrays = np.zeros((m, 1, 3)), {}
    force = np.zeros((m, 1, 2, 3))
    force[:, 0, 0, 2], force[:, 0, 1, 2] = 300 * (up < 14), 300 * ((up >= 12) | (up < 2))
    feet = np.zeros((m, 1, 2, 3))
    feet[..., 0] = 0.03 * (np.arange(m) // 12 * 12)[:, None, None]
    frame = np.tile([0.0, 0.0, np.pi / 2], (m, 1, 1))
    for name in ("pelvis_position", "pelvis_velocity", "body_position", "body_velocity"):
        arrays[name] = flat.copy()
    arrays["pelvis_position"][:, 0, 0] = 0.03 * np.arange(m)
    arrays["pelvis_velocity"][..., 0] = 1.0
    rest = {"phase": np.zeros((m, 1)), "reward": np.zeros((m, 1)), "action": np.zeros((m, 1, 10))}
    return Walks(
        command=np.ones((m, 1)),
        alive=np.ones((m, 1), dtype=bool),
        pelvis_orientation=np.zeros((m, 1, 4)),
        foot_position=feet,
        ground_force=force,
        body_to_foot=feet,
        frame=frame,
        **arrays,
        **rest,
    )


def test_steps_of_a_walk_are_found_in_its_heading():
    steps = models.steps_of(_gliding_walk(), first=5)
    assert len(steps.time) == 3
    np.testing.assert_allclose(steps.time, 0.36)
    np.testing.assert_allclose(steps.later[:, 0] - steps.now[:, 0], [[0.36, 0.0]] * 3, atol=1e-9)
    np.testing.assert_allclose(steps.now[:, 1], [[1.0, 0.0]] * 3, atol=1e-9)


def test_touchdowns_are_compared_with_the_plan_before_them():
    """The left foot lands 3 cm beside its foothold, 4 ms before the plan; the right one stands."""
    load = np.array([[[0, 300]], [[0, 300]], [[60, 250]], [[200, 100]], [[0, 300]]])
    feet = np.zeros((5, 1, 2, 2))
    feet[2:, 0, 0] = [0.5, 0.13]
    plan = np.full((5, 1, 3), np.nan)
    plan[1] = [0.5, 0.1, 0.024]
    seen = {
        "load": load.astype(float),
        "feet": feet,
        "height": np.full((5, 1, 2), 0.01),
        "sinking": np.full((5, 1, 2), 0.5),
        "plan": plan,
        "foot": np.zeros((5, 1), dtype=int),
        "walking": np.ones((5, 1), dtype=bool),
    }
    found = stepping_stones.touchdowns(seen)
    np.testing.assert_allclose(found["distance"], [0.03])
    np.testing.assert_allclose(found["late"], [-0.004])
    # a policy step later, when the next plan is of the right foot
    seen["foot"][1:] = 1
    plan[:2] = [[[0.5, 0.1, 0.024]], [[0.9, -0.1, 0.4]]]
    found = stepping_stones.touchdowns(seen)
    np.testing.assert_allclose(found["distance"], [0.03])
    np.testing.assert_allclose(found["late"], [0.026])
    seen["walking"][3:] = False
    assert len(stepping_stones.touchdowns(seen)["distance"]) == 0


def test_all_courses_of_the_table_have_as_many_stones():
    """Robots of one environment walk on all of them; stairs rise by what their row says."""
    courses = stepping_stones.courses_of(stepping_stones.Config(trials=2, count=5))
    assert {stones.shape for stones in courses.values()} == {(2, 7, 6)}
    for rise in stepping_stones.Config().stairs:
        heights = courses[f"stairs {rise:+g} m"][:, :, 2]
        np.testing.assert_allclose(np.diff(heights), rise)


def test_courses_are_completed_unless_a_robot_leaves_a_stone():
    """A blind robot walks over level treads, but not over two stones 1 m apart."""
    level = stairs(0.0, steps=2).stones
    apart = level.copy()
    apart[1], apart[2, 0] = apart[0] + [2.0, 0, 0, 0, 0, 0], 4.0
    config = stepping_stones.Config(trials=2, slowest=0.6, truth=True)
    subject = Subject.load("directions")
    courses = np.stack([level, apart])
    env = stepping_stones.environment(config, subject, {"": courses})
    with commands_kept(env):
        walked = stepping_stones.walk_courses(config, subject, env, courses)
    env.close()
    assert walked["completed"].tolist() == [True, False]
    assert np.isnan(walked["distance"]).all()


def test_robots_of_any_policy_may_have_another_planner():
    """Also of one that has never seen a plan; the environments fit the policies."""
    planners = {"exact": 4, "nearest": 4, "two": 2, "fixed": 4}
    assert tuple(planners) == stepping_stones.PLANNERS
    for policy, (name, footholds) in zip(
        2 * ("stones", "directions"), planners.items(), strict=True
    ):
        subject = stepping_stones.with_planner(Subject.load(policy), name)
        env = subject.env(1)
        td = subject.policy(env.reset())
        assert td["plan", "later_footholds"].shape == (1, footholds - 1, 3)
        assert td["action"].isfinite().all()
        env.close()
    assert stepping_stones.with_planner(subject, None) is subject
    with pytest.raises(UnknownNameError, match="no planner 'best'; there are"):
        stepping_stones.Config(planner="best")


def test_the_stone_vanishes_to_which_a_foot_in_flight_goes():
    """It is taken from the ground and from sight, of one robot only."""
    courses = random_stones(np.random.default_rng(0), 2, count=6, difficulty=0.0, step=0.22)
    env = aslip.make_env(num_envs=2, seed=0, stack=course_stack(planned_stack(), courses))
    td = env.reset()
    td["stones", "course"] = torch.as_tensor(courses, dtype=torch.float32)
    env.base_env.set_stones(courses)
    policy, stones = load_policy("stones"), courses.copy()
    for _ in range(100):
        before = footholds_in_world(td)[0, 0, :2]
        rows = stepping_stones.take_stones(env, td, stones, np.array([1, 99]))
        if len(rows):
            break
        td = env.step_mdp(env.step(policy(td)))
    assert rows.tolist() == [0]
    gone = int(np.isnan(stones[0, :, 0]).argmax())
    distance = np.linalg.norm(courses[0, :, :2] - before.numpy(), axis=-1)
    assert distance[1:-1].argmin() + 1 == gone
    np.testing.assert_array_equal(stones[1], courses[1])
    np.testing.assert_array_equal(env.base_env.stones, stones)
    np.testing.assert_allclose(np.asarray(td["stones", "course"]), stones, atol=1e-6)
    corners = torch.as_tensor(env.step(policy(td))["next", "stones", "corners"])
    assert corners.isfinite().flatten(2).all(-1).sum(-1).tolist() == [7, 8]


def test_the_planner_is_compared_with_brute_force(capsys):
    planner.main(planner.Config(problems=12, stones=2))
    shown = capsys.readouterr().out
    assert "| problems, with all steps on stones" in shown
    difference = float(shown.split("brute force |")[1].split("|")[0])
    assert difference < 1e-6
