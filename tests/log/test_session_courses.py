"""Logs of planned walks over stones: plans, footholds, and replays on the same ground."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase

import aslip
from aslip.envs.directions import course_stack, planned_stack
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log import Recorder, Recording, read, replay
from aslip.sim.course import Course, pattern, stairs
from aslip.transforms.plan_state import footholds_in_world
from tests.log.helpers import with_column

STEPS = 40


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[TensorDictBase]]:
    """Log of the second of two robots, which walk on treads, and the tensordicts of its steps."""
    path = tmp_path_factory.mktemp("courses") / "walk.mcap"
    treads = [stairs(0.0, steps=2), stairs(0.02, steps=2)]
    stack = course_stack(planned_stack(), treads) | {"recorder": Recorder(path, robot=1)}
    env = aslip.make_env(num_envs=2, seed=2, stack=stack, drop=["low_reward"], num_threads=1)
    start = {"command": torch.tensor([[0.3, 0.0, 0.0]] * 2), "stand": torch.zeros(2, 1)}
    policy, seen = aslip.load_policy("stones"), []
    td = env.reset(TensorDict(start, batch_size=2))
    for _ in range(STEPS):
        td["stand"] = torch.zeros(2, 1)
        after = env.step(policy(td))
        seen.append(after.clone())
        td = env.step_mdp(after)
    env.close()
    return read(path), seen


def test_a_replay_has_the_same_ground(walk: tuple[Recording, list[TensorDictBase]]) -> None:
    log, seen = walk
    assert replay(log).equal
    columns = ("x", "y", "z", "yaw", "length", "width")
    rows = np.stack([log["/stones"][name][-1] for name in columns], -1)
    np.testing.assert_array_equal(rows, seen[-1]["stones", "course"][1].double())
    lower = with_column(log, "/stones", "z", log["/stones"]["z"] - 0.05)
    assert not replay(lower).equal


def test_touchdowns_have_the_footholds_of_the_plan(
    walk: tuple[Recording, list[TensorDictBase]],
) -> None:
    """Planned places are in the world, those of `/plan` in the frame of the odometry."""
    log, seen = walk[0], cast("Any", walk[1])
    foothold = log["/plan"].vector("foothold")
    np.testing.assert_array_equal(foothold[1:], [td["next", "plan", "foothold"][1] for td in seen])
    later = np.stack([log["/plan"].vector(f"later_footholds_{i}") for i in range(3)], 1)
    expected = [td["next", "plan", "later_footholds"][1] for td in seen]
    np.testing.assert_array_equal(later[1:], expected)
    events = log["/touchdown"]
    assert len(events) >= 2
    for tick, x, y in zip(events.ticks, events["x_planned"], events["y_planned"], strict=True):
        planned = footholds_in_world(seen[tick - 1])[1, 0, :2]
        np.testing.assert_allclose([x, y], planned, atol=1e-6)
    away = np.hypot(events["x"] - events["x_planned"], events["y"] - events["y_planned"])
    assert away.max() < 0.25


def test_a_log_has_room_for_the_stones_that_it_begins_with(tmp_path: Path) -> None:
    course = pattern("straight", count=3)
    stack = course_stack(planned_stack(), [course])
    for name, more in (("a", pattern("straight", count=4)), ("b", Course(course.stones[:2]))):
        stack["recorder"] = Recorder(tmp_path / f"{name}.mcap")
        env = aslip.make_env(num_envs=1, seed=2, stack=stack, num_threads=1)
        td = env.reset()
        env.base_env.set_course(more)
        td["action"] = torch.zeros(1, 10)
        if name == "a":
            with pytest.raises(ConfigurationError, match="up to 5 stones, got 6"):
                env.step(td)
        else:
            env.step(td)
        env.close()
    # the second course is shorter: places without stones are NaN
    last = read(tmp_path / "b.mcap")["/stones"]["x"][-1]
    assert np.isnan(last).tolist() == [False, False, True, True, True]


def test_damaged_stones_are_refused(walk: tuple[Recording, list[TensorDictBase]]) -> None:
    log = walk[0]
    series = log["/stones"]
    wider = {name: np.tile(column, 2) for name, column in series.columns.items()}
    for other, message in (
        (replace(series, columns={**series.columns, "length": -series["length"]}), "above 0"),
        (replace(series, columns=wider), "more stones than the model"),
        (replace(series, time=series.time + 1.0), "/stones does not begin before"),
    ):
        with pytest.raises(FileDamagedError, match=message):
            replay(replace(log, series={**log.series, "/stones": other}))
