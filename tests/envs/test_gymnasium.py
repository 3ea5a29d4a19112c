"""Gymnasium environments pass its checker, and agents of other libraries train on them."""

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from stable_baselines3 import PPO
from tensordict import TensorDict
from torchrl.envs import StepCounter

import aslip
from aslip.envs import GymEnv, GymVectorEnv
from aslip.errors import ConfigurationError, UnknownNameError
from tests.test_docs import DOCS, blocks

ID = "aslip.envs.gymnasium:aslip/Walk-v0"


@pytest.fixture(scope="module")
def one() -> Iterator[GymEnv]:
    env = GymEnv(num_threads=1)
    yield env
    env.close()


@pytest.fixture(scope="module")
def four() -> Iterator[GymVectorEnv]:
    envs = GymVectorEnv(4, seed=0, num_threads=1)
    yield envs
    envs.close()


def test_environments_pass_gymnasiums_checker() -> None:
    env = gymnasium.make(ID, num_threads=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    # warnings about the bounds of the spaces are advice
    assert not [
        w for w in caught if "infinity" not in str(w.message) and "symm" not in str(w.message)
    ]
    env.close()


def test_step_equals_the_step_of_the_stack(one: GymEnv) -> None:
    ours = aslip.make_env(num_threads=1, seed=9)
    state = ours.reset(ours.fake_tensordict().select("command").apply(lambda x: x + 1))
    observation, info = one.reset(seed=9, options={"command": 1.0})
    assert observation.shape == (64,) and observation.dtype == np.float32
    action = np.full(10, 0.1, dtype=np.float32)
    for _ in range(3):
        assert np.array_equal(observation, np.asarray(state["observation"][0]))
        after = ours.step(state.set("action", torch.from_numpy(action)[None]))["next"]
        observation, reward, terminated, truncated, info = one.step(action)
        assert reward == after["reward"].item()
        assert (terminated, truncated) == (False, False)
        assert info["command"] == 1.0
        assert info["reward_terms"]["com_vel"] == after["reward_terms", "com_vel"].item()
        state = ours.step_mdp(after) if "next" in after else after


def test_time_limits_truncate_and_falls_terminate(one: GymEnv) -> None:
    env = GymEnv(replace={"step_limit": StepCounter(2)}, drop=["low_reward"], num_threads=1)
    env.reset(seed=0)
    ends = [env.step(np.zeros(10))[2:4] for _ in range(2)]
    assert ends == [(False, False), (False, True)]
    one.reset(seed=0)
    assert one.step(np.full(10, np.nan))[2:4] == (True, False)


def test_seeds_repeat_episodes_and_unseeded_environments_differ(one: GymEnv) -> None:
    first, _ = one.reset(seed=3)
    second, _ = one.reset()
    again, _ = one.reset(seed=3)
    assert np.array_equal(first, again) and not np.array_equal(first, second)
    assert not np.array_equal(GymEnv().reset()[0], GymEnv().reset()[0])


@pytest.mark.usefixtures("pictures")
def test_pictures_show_the_robot_move(one: GymEnv) -> None:
    assert one.render() is None
    env = GymEnv("rgb_array", num_threads=1)
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    env.step(np.full(10, 1.0))
    later = env.render()
    assert later is not None and not np.array_equal(picture, later)
    env.close()


def test_robots_are_reset_in_the_step_that_ends_their_episode(four: GymVectorEnv) -> None:
    first, _ = four.reset(seed=1, options={"command": 0.2})
    assert four.observation_space.contains(first)
    actions = np.zeros((4, 10), dtype=np.float32)
    actions[2] = np.nan
    observation, reward, terminated, truncated, info = four.step(actions)
    assert reward.shape == terminated.shape == truncated.shape == (4,)
    assert terminated.tolist() == [False, False, True, False]
    assert info["_final_obs"].tolist() == terminated.tolist()
    assert info["final_obs"][0] is None
    assert not np.array_equal(info["final_obs"][2], observation[2])
    assert info["final_info"]["reward_terms"]["com_vel"].shape == (4,)
    # the new episode has a command of its own
    np.testing.assert_array_equal(info["final_info"]["command"], np.float32(0.2))
    assert (info["command"] == np.float32(0.2)).tolist() == [True, True, False, True]


def test_vector_steps_equal_the_steps_of_the_stack(four: GymVectorEnv) -> None:
    ours = aslip.make_env(num_envs=4, num_threads=1, seed=2)
    observation, _ = four.reset(seed=2)
    state = ours.reset()
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert np.array_equal(observation, state["observation"].numpy())
        actions = rng.uniform(-0.5, 0.5, (4, 10)).astype(np.float32)
        _, state = ours.step_and_maybe_reset(state.set("action", torch.from_numpy(actions)))
        observation, *_ = four.step(actions)


def test_robots_are_reset_in_the_step_after_the_end_of_their_episode() -> None:
    """`NormalizeObservation` accepts this mode; robots that are not reset walk on bit-equal."""
    inner = GymVectorEnv(3, AutoresetMode.NEXT_STEP, seed=0, num_threads=1)
    envs, ours = NormalizeObservation(inner), aslip.make_env(num_envs=3, seed=0, num_threads=1)
    envs.reset(seed=1, options={"command": 0.2})
    rows, actions = [], np.zeros((3, 10), dtype=np.float32)
    for bad in (np.nan, np.nan, 0.0):
        actions[1] = bad
        _, reward, terminated, truncated, info = envs.step(actions)
        rows.append((terminated.tolist(), reward[1] > 0))
        assert not truncated.any() and "final_obs" not in info
        assert (info["command"] == np.float32(0.2)).tolist() == [True, len(rows) == 1, True]
    ends, none = [False, True, False], [False] * 3
    assert rows == [(ends, False), (none, False), (none, True)]
    ours.set_seed(1)
    state = ours.reset(TensorDict(command=torch.full((3, 1), 0.2), batch_size=3))
    for _ in range(3):
        state = ours.step_mdp(ours.step(state.set("action", torch.zeros(3, 10))))
    alone, among = state["truth", "qpos"], inner._state["truth", "qpos"]
    assert (alone == among).all(-1).tolist() == [True, False, True]
    envs.close()


def test_wrong_settings_and_options_are_refused(one: GymEnv) -> None:
    with pytest.raises(ConfigurationError, match="render_mode"):
        GymEnv("human")
    with pytest.raises(ConfigurationError, match=r"autoreset_mode must be one of.*NextStep"):
        GymVectorEnv(2, "never")
    with pytest.raises(ConfigurationError, match="GymVectorEnv"):
        GymEnv(num_envs=2)
    with pytest.raises(UnknownNameError, match="command"):
        one.reset(options={"comand": 1.0})


@pytest.fixture(scope="module")
def adapters() -> dict[str, Any]:
    """Classes of the page on other libraries."""
    names: dict[str, Any] = {"np": np}
    for _, code in blocks((DOCS / "libraries.md").read_text(), "python"):
        if "\nclass " in code:
            exec(code, names)
    return names


def test_stable_baselines_ppo_trains(four: GymVectorEnv, adapters: dict[str, Any]) -> None:
    envs = adapters["BatchVecEnv"](four)
    agent = PPO("MlpPolicy", envs, n_steps=4, batch_size=16, n_epochs=1, seed=0, device="cpu")
    before = [p.clone() for p in agent.policy.parameters()]
    assert agent.learn(16).num_timesteps == 16
    moved = [not torch.equal(a, b) for a, b in zip(before, agent.policy.parameters(), strict=True)]
    assert all(moved)


def test_adapters_tell_time_limits_from_falls(adapters: dict[str, Any]) -> None:
    """And give the first observation of the next episode, Stable-Baselines3 the last one, too."""
    settings: dict[str, Any] = {"replace": {"step_limit": StepCounter(2)}, "num_threads": 1}
    envs = adapters["BatchVecEnv"](GymVectorEnv(3, **settings))
    rsl = adapters["RslEnv"](aslip.make_env(num_envs=3, seed=1, **settings))
    envs.seed(1)
    envs.reset()
    actions = np.zeros((3, 10), dtype=np.float32)
    actions[1] = np.nan
    for last in (False, True):
        observations, rewards, dones, infos = envs.step(actions)
        seen, reward, done, extras = rsl.step(torch.from_numpy(actions))
        assert np.array_equal(observations, seen["policy"].numpy())
        assert np.array_equal(rewards, reward.numpy())
        assert dones.tolist() == done.tolist() == [last, True, last]
        limits = [info.get("TimeLimit.truncated", False) for info in infos]
        assert limits == extras["time_outs"].tolist() == [last, False, last]
        for i in np.flatnonzero(dones):
            assert not np.array_equal(infos[i]["terminal_observation"], observations[i])
    rsl.episode_length_buf = torch.tensor([0, 1, 0])
    actions[:] = 0
    assert rsl.step(torch.from_numpy(actions))[3]["time_outs"].tolist() == [False, True, False]


def test_vectors_take_the_wrapper_of_cleanrl(four: GymVectorEnv) -> None:
    envs = RecordEpisodeStatistics(four)
    envs.reset(seed=0)
    lengths = []
    for _ in range(40):
        *_, info = envs.step(np.full((4, 10), 0.3, dtype=np.float32))
        if "final_obs" in info:
            lengths += info["episode"]["l"][info["_episode"]].tolist()
    assert lengths and min(lengths) > 1
