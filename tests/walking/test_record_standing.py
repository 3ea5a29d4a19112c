"""Recording and interactive walks of robots that can stand."""

import numpy as np
import pytest
from tensordict.utils import NestedKey

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import GaitLibrary, WalkMode
from aslip.robot import CASSIE
from aslip.transforms import StandCommand
from aslip.walking import Walker, evaluate, record_substeps, record_walks
from aslip.walking.record import commands_kept, next_start, record, reset_walks, walk
from tests.helpers import limp
from tests.library.standing import standing_library


@pytest.fixture(scope="module")
def library() -> GaitLibrary:
    return standing_library()


def make(library: GaitLibrary, num_envs: int = 1, **settings: object) -> StackEnv:
    return aslip.make_env(
        stack="directions", library=library, num_envs=num_envs, num_threads=1, drop=EPISODE_ENDS,
        seed=0,
        **settings,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip


def test_recorded_robots_stand_on_command(library: GaitLibrary) -> None:
    """And walk by default, though the stack draws stand commands at resets and within episodes."""
    env = make(library, 2, replace={"stand": StandCommand(1.0, 0.03)})
    command = np.zeros((6, 2, 3))
    stand = np.array([[1, 1]] * 3 + [[0, 1]] * 3)
    keys: list[NestedKey] = [("next", "mode"), ("next", "stand")]
    recorded = record(limp(), env, command, keys, stand=stand)
    modes = np.asarray(recorded["next", "mode"])[..., 0]
    assert (modes[:3] == WalkMode.STAND).all()
    assert (modes[3:, 0] == WalkMode.START).all()
    assert (modes[3:, 1] == WalkMode.STAND).all()
    free = record(limp(), env, command, keys)
    assert not any(np.asarray(free[key]).any() for key in keys)
    walks = record_walks(limp(), env, command, stand)
    # in standing, the model's body does not move
    assert np.abs(walks.body_velocity[:3]).max() < 1e-12
    assert np.abs(record_walks(limp(), env, command).body_velocity[:3]).max() > 0.1
    with pytest.raises(ShapeError, match=r"stand must be \(6, 2\)"):
        record_walks(limp(), env, command, stand[:, :1])
    assert [result.survived for result in evaluate(limp(), env, command[0].tolist(), 3)] == [
        True
    ] * 2


def test_walker_stands_on_command(library: GaitLibrary) -> None:
    walker = Walker(limp(), make(library), library=library)
    assert walker.can_stand
    assert not walker.stand
    walker.stand = True
    walker.step()
    assert walker.stand
    walker.reset(stand=True)
    assert walker.stand
    assert np.asarray(walker.step()["next", "mode"]) == WalkMode.STAND
    walker.stand = False
    assert np.asarray(walker.step()["next", "mode"]) == WalkMode.START
    walker.reset()
    assert not walker.stand


def test_substeps_take_stand_commands(library: GaitLibrary) -> None:
    walk = record_substeps(limp(), make(library), np.zeros((2, 3)), np.ones(2))
    assert np.ptp(walk.pelvis_position, axis=0).max() < 0.01


def test_stand_commands_need_a_stack_that_stands() -> None:
    env = aslip.make_env(num_threads=1, drop=EPISODE_ENDS, seed=0)
    record_walks(limp(), env, np.zeros((2, 1)), np.zeros((2, 1)))
    with pytest.raises(ConfigurationError, match="directions_stack"):
        record_walks(limp(), env, np.zeros((2, 1)), np.array([[0], [1]]))
    with pytest.raises(ConfigurationError, match="directions_stack"):
        record_substeps(limp(), env, np.zeros(2), np.ones(2))


def test_standing_robots_step_when_they_are_pushed_and_stand_again() -> None:
    """By 12 N s, forward, back and to the right; without a step they fall."""
    env = aslip.make_env(num_envs=3, seed=7, stack="directions", drop=EPISODE_ENDS, num_threads=1)
    policy, still = aslip.load_policy("directions"), np.zeros((3, 3))
    push = 12 / (7 * CASSIE.policy_period) * np.array([[1, 0, 0], [-1, 0, 0], [0, -1, 0]])
    with commands_kept(env):
        td, modes = reset_walks(env, still, stand=1.0), []
        for steps, force in ((20, None), (7, push), (120, None)):
            for step in walk(policy, env, td, steps, push=force):
                assert not step["next", "terminated"].any()
                modes.append(step["next", "mode"][:, 0].numpy())
            td = next_start(step)
    assert (modes[19] == WalkMode.STAND).all()
    assert (np.array(modes) == WalkMode.WALK).any(axis=0).all()
    assert (modes[-1] == WalkMode.STAND).all()
