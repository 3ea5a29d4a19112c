"""Recorded arrays equal the log of the same walk."""

from pathlib import Path

import numpy as np
import pytest

import aslip
from aslip.envs import EPISODE_ENDS, default_stack
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import GaitLibrary
from aslip.log import Recorder, read, read_walk
from aslip.robot import CASSIE
from aslip.walking import Walks, record_walks
from tests.helpers import MakeEnv

STEPS = 40


def _command(*speeds: float) -> np.ndarray:
    return np.tile(np.array(speeds), (STEPS, 1))


@pytest.fixture(scope="module")
def logged(library: GaitLibrary, tmp_path_factory: pytest.TempPathFactory) -> tuple[Walks, Path]:
    """Walk of one robot, as arrays and as a log."""
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    stack = {**default_stack(library), "recorder": Recorder(path)}
    env = aslip.make_env(stack=stack, drop=EPISODE_ENDS, num_threads=1, seed=3)
    command = _command(0.5)
    command[20:] = 1.0
    walk = record_walks(aslip.load_policy("straight"), env, command)
    env.close()
    return walk, path


def test_log_reproduces_recorded_walk(logged: tuple[Walks, Path]) -> None:
    walk, path = logged
    read_back = read_walk(read(path))
    for name, values in vars(walk).items():
        np.testing.assert_array_equal(getattr(read_back, name), values, err_msg=name)


def test_log_reproduces_recorded_fall(library: GaitLibrary, tmp_path: Path) -> None:
    """Even if a step after the divergence succeeds again."""
    policy, path, count = aslip.load_policy("straight"), tmp_path / "fall.mcap", 0

    def fails(td):
        nonlocal count
        td, count = policy(td), count + 1
        if count == 6:
            td["action"][:] = np.nan
        return td

    stack = {**default_stack(library), "recorder": Recorder(path)}
    env = aslip.make_env(stack=stack, drop=EPISODE_ENDS, num_threads=1, seed=0)
    walk = record_walks(fails, env, _command(0.5))  # pyright: ignore[reportArgumentType]
    env.close()
    read_back = read_walk(read(path))
    assert read_back.survived.tolist() == [False]
    for name, values in vars(walk).items():
        np.testing.assert_array_equal(getattr(read_back, name), values, err_msg=name)


def test_rows_are_one_policy_step_apart(logged: tuple[Walks, Path]) -> None:
    walk = logged[0]
    velocity = np.diff(walk.pelvis_position[:, 0], axis=0) / CASSIE.policy_period
    middle = (walk.pelvis_velocity[1:, 0] + walk.pelvis_velocity[:-1, 0]) / 2
    np.testing.assert_allclose(velocity, middle, atol=0.12)
    assert walk.command[[0, 19, 20, -1], 0].tolist() == [0.5, 0.5, 1.0, 1.0]
    assert walk.survived.tolist() == [True]
    # the model's feet do not go below the floor
    assert (walk.body_position[:, 0, 2:] + walk.body_to_foot[:, 0, :, 2] > -2e-3).all()


def test_rows_after_fall_are_nan(make: MakeEnv) -> None:
    """One robot gets constant actions and falls, the other walks; both stay in the record."""
    policy = aslip.load_policy("straight")

    def clumsy(td):
        td = policy(td)
        td["action"][1] = 1.0
        return td

    env = make(num_envs=2, drop=EPISODE_ENDS)
    walks = record_walks(clumsy, env, _command(0.5, 0.5))  # pyright: ignore[reportArgumentType]
    assert walks.survived.tolist() == [True, False]
    fell = int(np.flatnonzero(~walks.alive[:, 1])[0])
    assert not walks.alive[fell:, 1].any()
    assert np.isnan(walks.pelvis_position[fell:, 1]).all()
    assert np.isfinite(walks.pelvis_position[:fell, 1]).all()
    assert np.isfinite(walks.ground_force[:, 0]).all()


def test_refuses_invalid_commands(make: MakeEnv) -> None:
    env, policy = make(num_envs=2), aslip.load_policy("straight")
    with pytest.raises(ShapeError, match=r"\(m, 2\)"):
        record_walks(policy, env, _command(0.5))
    with pytest.raises(ShapeError, match=r"a policy step or more, got \(0, 2\)"):
        record_walks(policy, env, np.zeros((0, 2)))
    with pytest.raises(ConfigurationError, match="finite"):
        record_walks(policy, env, _command(0.5, np.nan))
    with pytest.raises(ConfigurationError, match="know where robots are"):
        record_walks(policy, make(keep=["observation"]), _command(0.5))
