"""A training of planned footsteps starts from a policy and gives one that walks over a course."""

from contextlib import closing
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

from aslip.envs import make_env
from aslip.errors import ConfigurationError
from aslip.library import Schedule
from aslip.policy import (
    RunningNormalizer,
    load_policy,
    make_planned_actor,
    policy_stack,
    read_card,
)
from aslip.sim.course import Course, pattern
from recipes import stepping_stones, walk
from recipes.ppo_aslip import start_from
from recipes.stepping_stones import StonesConfig
from tests.helpers import TINY


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> StonesConfig:
    out = tmp_path_factory.mktemp("runs") / "tiny"
    own = {"out": out, "library": "directions", "start": "directions", "critic_steps": 64}
    config = StonesConfig(**{**vars(TINY), **own})
    stepping_stones.main(config)
    return config


def test_the_policy_starts_from_another_which_waits_for_the_critic(config: StonesConfig) -> None:
    """The first of two updates is the critic's alone; inputs that it lacks begin at zero."""
    assert policy_stack(config.out) == "planned"
    assert read_card(config.out)["network"] == "planned"
    before, both = load_policy("directions").state_dict(), load_policy(config.out).state_dict()
    has = next(len(value) for name, value in before.items() if name.endswith("mean"))
    parts = []
    for part in ("plans", "gaits"):
        names = {n.replace(f"{part}.", ""): v for n, v in both.items() if f".{part}." in n}
        new = {n: v[..., has:] for n, v in names.items() if v.shape[-1:] == (has + 5,)}
        parts.append((new, names | {n: names[n][..., :has] for n in new}))
    (new, after), (no, kept) = parts
    counts = [v for values in (new, after) for k, v in values.items() if k.endswith("count")]
    assert (counts[0] == config.total_steps).all()
    assert (counts[1] > counts[0][0]).all()
    first = next(value for name, value in new.items() if "weight" in name)
    assert 0 < first.abs().max() < 20 * config.learning_rate
    moved = [(after[name] - before[name]).abs().max() for name in after if "weight" in name]
    # two epochs of Adam at most
    assert 0 < torch.stack(moved).max() < 20 * config.learning_rate
    # what robots without stones do stays as it is
    assert all(torch.equal(kept[n], v) for n, v in before.items() if not n.endswith("scale"))
    assert not any(value.any() for value in no.values())


def test_a_policy_of_two_networks_starts_with_both() -> None:
    with closing(make_env(num_envs=1, stack="planned")) as env:
        actor = make_planned_actor(RunningNormalizer(87), read_card("stones")["shape"])
        start_from("stones", actor, env)
    found, expected = (net.state_dict() for net in (actor, load_policy("stones")))
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[name], value) for name, value in expected.items())
    with pytest.raises(ConfigurationError, match="start must be a policy"):
        StonesConfig(start=None)


def test_a_policy_walks_over_a_course_of_ones_own(
    config: StonesConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern("straight", count=3).write(tmp_path / "mine.json")
    settings = {"command": "0:0.5 0 0", "duration": 0.6, "course": str(tmp_path / "mine.json")}
    walk.main(walk.Config(policy=str(config.out), **settings))  # pyright: ignore
    assert "the robot walked for 0.60 s\n" in capsys.readouterr().out
    settings["course"] = str(tmp_path / "short.json")
    pattern("straight", count=1).write(tmp_path / "short.json")
    walk.main(walk.Config(policy="stones", **{**settings, "duration": 6.0}))  # pyright: ignore
    assert "the robot walked for 6.00 s, to the end of the course" in capsys.readouterr().out
    with pytest.raises(ConfigurationError, match=r"stepping_stones\.py trains one"):
        walk.main(walk.Config(course="up"))


def test_a_course_has_polygons_and_that_of_the_page_room_for_stones(config: StonesConfig) -> None:
    course = pattern("straight", count=3)
    bent = Course(course.stones, {1: np.array([[1.0, 0.0], [1.2, 0.1], [1.0, 0.2]])})
    settings: Any = {"policy": str(config.out), "command": "0:0.5 0 0"}
    schedule = Schedule.parse(settings["command"])
    walker = walk.make_walker(walk.Config(**settings), schedule, bent)
    corners = cast("torch.Tensor", walker.td["stones", "corners"])
    assert corners[0, :5].isfinite().all()
    np.testing.assert_array_equal(walker.env.base_env.stones[0], bent.stones)
    live = walk.Config(**settings, live=True)
    with pytest.raises(ConfigurationError, match="the page moves rectangular stones"):
        walk.make_walker(live, schedule, bent)
    stones = walk.make_walker(live, schedule, course).stones
    assert stones is not None
    np.testing.assert_allclose(stones[:5], course.stones, atol=1e-6)
    assert stones[5:].shape == (10, 6)
    assert np.isnan(stones[5:]).all()


def test_courses_are_of_a_share_of_the_episodes() -> None:
    ground, shown = stepping_stones.course_pool(0.25, 1.0)
    assert np.isnan(ground[:, 0, 0]).mean() == pytest.approx(0.75)
    assert np.array_equal(np.isnan(ground), np.isnan(shown))


def test_on_a_share_of_them_no_robot_falls_into_a_gap() -> None:
    """The ground reaches from stone to stone, at the height of the nearest one, without turns."""
    ground, shown = stepping_stones.course_pool(1.0, 0.4)
    widened, turns = (ground != shown).any((1, 2)), (shown[..., 3] != 0).any(1)
    assert widened[~turns].mean() == pytest.approx(0.4, abs=0.05)
    assert not widened[turns].any()
    edges = ground[widened][..., :1] + ground[widened][..., 4:5] * np.array([-0.5, 0.5])
    np.testing.assert_allclose(edges[:, 1:, 0], edges[:, :-1, 1], atol=1e-12)
    assert np.array_equal(ground[..., 2], shown[..., 2])
    middle = shown[widened][..., 0]
    assert ((edges[..., 0] < middle) & (middle < edges[..., 1])).all()


def test_varied_courses_have_steps_of_their_own() -> None:
    stones = stepping_stones.varied_stones(np.random.default_rng(0), 600, 0.2)[:, 1:-1]
    step = np.linalg.norm(np.diff(stones[..., :2], axis=1), axis=-1)
    turns, treads = (stones[..., 3] != 0).any(1), stones[:, 0, 5] > 1
    assert turns.mean() == pytest.approx(0.4)
    assert treads.mean() == pytest.approx(0.25)
    assert not (turns & treads).any()
    # treads touch
    np.testing.assert_allclose(step[treads], stones[treads, 1:, 4], atol=1e-12)
    assert np.ptp(step[~treads].mean(1)) > 0.25
    rise = np.diff(stones[..., 2], axis=1)
    assert abs(rise).max() < 0.2  # the planner's limit
    assert rise[treads].min() < -0.13
    assert rise[treads].max() > 0.13
    assert np.ptp(rise[~treads].mean(1)) > 0.15
