"""`Walker`: one robot that takes commands step by step."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

import aslip
from aslip.envs import EPISODE_ENDS, MAX_EPISODE_STEPS
from aslip.envs.directions import course_stack, planned_stack
from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.library import GaitLibrary
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, save_policy, stack_name
from aslip.robot import CASSIE
from aslip.sim.course import pattern
from aslip.transforms import SINGLE_REFERENCE_TABLE
from aslip.walking import Walker


@pytest.fixture(scope="module")
def walker(library: GaitLibrary) -> Walker:
    return Walker("straight", library=library, seed=0)


@pytest.fixture(autouse=True)
def fresh(walker: Walker) -> None:
    walker.env.set_seed(0)
    walker.reset(0.5)


def _velocity(walker: Walker) -> torch.Tensor:
    return walker.td["truth", "pelvis_velocity"][0]  # pyright: ignore


def test_walker_follows_command_beyond_the_episode_limit(walker: Walker) -> None:
    for speed, settling in ((0.5, 60), (1.0, MAX_EPISODE_STEPS - 219)):
        walker.command = speed
        for _ in range(settling):
            walker.step()
        start = float(walker.td["truth", "pelvis_position"][0, 0])  # pyright: ignore
        for _ in range(80):
            td = walker.step()
            assert float(td["next", "command"]) == speed  # pyright: ignore
        displacement = float(walker.td["truth", "pelvis_position"][0, 0]) - start  # pyright: ignore
        assert displacement / 2.4 == pytest.approx(speed, abs=0.15)
    assert walker.time == pytest.approx((MAX_EPISODE_STEPS + 1) * CASSIE.policy_period)
    assert not walker.fallen


def test_push_has_duration_and_effect(walker: Walker) -> None:
    twin = Walker(walker.policy, library=walker.library, speed=0.5, seed=0)
    walker.push((0.0, 60.0, 0.0), 0.1)  # four policy steps
    pushed = [walker.step().get("push", None) is not None for _ in range(8)]
    assert pushed == [True] * 4 + [False] * 4
    for _ in range(8):
        twin.step()
    assert _velocity(walker)[1] > _velocity(twin)[1] + 0.05
    # a reset ends the push
    walker.push((0.0, 60.0, 0.0), 1.0)
    walker.reset()
    assert walker.step().get("push", None) is None


def test_a_push_is_seen_from_the_robot(walker: Walker) -> None:
    """A push to the front of a robot that faces along y goes along y."""
    walker.td["truth", "pelvis_orientation"] = torch.tensor([[0.5**0.5, 0.0, 0.0, 0.5**0.5]])
    walker.push((60.0, 0.0, 5.0))
    torch.testing.assert_close(walker.step()["push"], torch.tensor([[0.0, 60.0, 5.0]]))


def test_fallen_walker_needs_reset(walker: Walker) -> None:
    walker.push((0.0, 3000.0, 0.0), 0.3)
    while not walker.fallen:
        walker.step()
        assert walker.steps < 100
    with pytest.raises(ConfigurationError, match="reset"):
        walker.step()
    walker.reset()
    assert walker.command == 0.5
    assert walker.steps == 0
    for _ in range(20):
        walker.step()
    assert not walker.fallen


@pytest.mark.parametrize("speed", [-0.1, 2.5, float("nan")])
def test_refuses_speed_outside_library(walker: Walker, speed: float) -> None:
    with pytest.raises(SpeedOutOfRangeError):
        walker.command = speed
    with pytest.raises(SpeedOutOfRangeError):
        walker.reset(speed)
    assert walker.command == 0.5


@pytest.mark.parametrize("command", [[2.2, 0.0, 0.0], (0.3, 0.1, 0.2)])
def test_commands_are_sequences_of_any_kind(command: Sequence[float]) -> None:
    """Lists and tuples of three numbers are commands; one at the border can be assigned again."""
    walker = Walker("directions", speed=command, seed=0)
    walker.command = read = walker.command
    walker.reset(list(command))
    assert walker.command == pytest.approx(tuple(command)) == read


def test_refuses_policy_of_another_stack(tmp_path: Path) -> None:
    walker = Walker("straight", seed=0)
    other = save_other_policy(tmp_path / "other.zip")
    with pytest.raises(ConfigurationError, match=r"other.zip.*lacks \['reference/body"):
        walker.policy = other
    assert stack_name(Walker(other, seed=0).env) == "single_reference"


def test_stones_move_while_the_robot_walks() -> None:
    """It falls where they were, and sees where they are."""
    stack = course_stack(planned_stack(), [pattern("straight")])
    env = aslip.make_env(stack=stack, drop=EPISODE_ENDS, num_threads=1, seed=0)
    walker = Walker("stones", env, speed=0.4)
    walker.step()
    stones = walker.stones
    assert stones is not None
    stones[0, 2], stones[1:] = -0.5, np.nan
    walker.stones = given = stones.astype(np.float32)
    given[0, 2] = 0.7  # later changes of the caller's array do not count
    assert cast("np.ndarray", walker.stones)[0, 2] == -0.5
    walker.step()
    seen = cast("torch.Tensor", walker.td["stones", "height"])[0]
    assert int(seen.isfinite().sum()) == 1
    while not walker.fallen:
        walker.step()
    assert walker.time < 1.0
    with pytest.raises(ShapeError, match=r"must have shape \(22, 6\), got \(21, 6\)"):
        walker.stones = stones[1:]
    with pytest.raises(ConfigurationError, match="course_stack"):
        Walker("straight", seed=0).stones = stones


def test_a_loaded_policy_is_named_with_its_stack_if_the_environment_has_another() -> None:
    policy, env = (
        aslip.load_policy("directions"),
        aslip.make_env(stack="directions", num_threads=1, seed=0),
    )
    # commands are those of the environment
    assert Walker(policy, env, speed=(0.3, 0.0, 0.1)).command == pytest.approx((0.3, 0.0, 0.1))
    stacks = "it was trained on the stack 'directions', .* has the stack 'straight'"
    with pytest.raises(ConfigurationError, match=f"'directions' does not.*82 numbers.*{stacks}"):
        Walker(policy)
    with pytest.raises(ConfigurationError, match=r"'straight' does not fit.*the stack 'straight'"):
        Walker(aslip.load_policy("straight"), env)


def save_other_policy(path: Path) -> Path:
    shape = PolicyShape(49)
    actor = make_actor(RunningNormalizer(49), shape)
    names = {"observation": SINGLE_REFERENCE_TABLE, "baseline": ("reference", "motor_position")}
    save_policy(path, actor, shape, stack="single_reference", **names)
    return path
