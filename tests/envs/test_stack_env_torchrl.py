"""Environments work with TorchRL's own transforms, losses and collectors."""

import copy
import pickle
from functools import partial
from typing import Any

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.data import Bounded
from torchrl.envs import ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.transforms import (
    ActionScaling,
    ExcludeTransform,
    FrameSkipTransform,
    InitTracker,
    NoopResetEnv,
    RewardScaling,
    RewardSum,
)
from torchrl.envs.utils import check_env_specs

from aslip import load_policy
from aslip.envs import default_stack, make_env
from aslip.errors import ConfigurationError
from aslip.transforms import LowReward
from tests.helpers import STRAIGHT_STACKS, MakeEnv


@pytest.mark.parametrize("stack", STRAIGHT_STACKS)
def test_reward_is_one_entry_and_its_terms_are_observations(make: MakeEnv, stack: str) -> None:
    env = make(num_envs=2, stack=stack, library=None)
    assert env.reward_keys == ["reward"]
    assert env.reward_key == "reward"
    start = env.reset()
    terms = start["reward_terms"]
    assert terms.keys()
    assert all((term == 0).all() for term in terms.values())
    after = env.step(start.set("action", torch.zeros(2, 10)))["next"]
    assert after["reward_terms"].keys() == terms.keys()
    assert all((term > 0).all() for term in after["reward_terms"].values())


def test_random_actions_may_precede_an_episode(make: MakeEnv) -> None:
    env = make(drop=["low_reward", "fall"])
    env.append_transform(NoopResetEnv(3, random=False))
    assert env.reset()["step_count"].item() == 3
    assert env.rollout(3)["next", "step_count"].flatten().tolist() == [4, 5, 6]


def test_shipped_policies_act_within_the_action_spec(make: MakeEnv) -> None:
    for policy, stack in (("straight", "straight"), ("single_reference", "single_reference")):
        env = make(num_envs=5, stack=stack, library=None, seed=1)
        data = env.rollout(30, load_policy(policy))
        assert data["action"].abs().amax() > 0.2
        assert env.action_spec.is_in(data["action"].transpose(0, 1))


def test_actions_can_be_scaled(make: MakeEnv) -> None:
    """Action one is the upper bound of the spec."""
    plain, scaled = make(num_envs=2), make(num_envs=2)
    high = plain.action_spec.high
    scaled.append_transform(ActionScaling())
    check_env_specs(scaled)
    check_env_specs(TransformedEnv(make(num_envs=2), ActionScaling()))
    seen = []
    for env, action in ((plain, 0.2 * high), (scaled, torch.full((2, 10), 0.2))):
        env.set_seed(1)
        seen.append(env.step(env.reset().set("action", action))["next", "last_action"])
    torch.testing.assert_close(seen[0], seen[1])
    assert scaled.action_spec.is_in(torch.ones(2, 10))
    assert not scaled.action_spec.is_in(torch.full((2, 10), 1.1))


def test_action_spec_cannot_be_set(make: MakeEnv) -> None:
    env = make(num_envs=2)
    with pytest.raises(ConfigurationError, match=r"ActionDelta\(limit="):
        env.action_spec = Bounded(-1.0, 1.0, torch.Size((2, 10)))
    before = env.action_spec
    env.append_transform(RewardScaling(0.0, 2.0))
    assert env.action_spec == before


def test_shipped_policies_collect_without_warnings(
    make: MakeEnv, recwarn: pytest.WarningsRecorder
) -> None:
    collector = Collector(make(num_envs=2), load_policy("straight"), frames_per_batch=8)
    data = next(iter(collector))
    collector.shutdown()
    assert [str(w.message) for w in recwarn if "transforms required" in str(w.message)] == []
    assert data["is_init"][:, 0].all()
    assert not data["is_init"][:, 1:].any()


def test_first_steps_and_sums_of_rewards_are_those_of_torchrl(make: MakeEnv) -> None:
    env = make(num_envs=3, replace={"low_reward": LowReward(0.7)})
    env.append_transform(InitTracker("torchrl_is_init"))
    env.append_transform(RewardSum(in_keys=["reward"], out_keys=["torchrl_sum"]))
    torch.manual_seed(0)
    data = env.rollout(30, break_when_any_done=False)
    done = data["next", "done"][..., 0]
    assert (done.any(0) & ~done.all(0)).any()  # some robots were reset while others continued
    for level in (data, data["next"]):
        assert torch.equal(level["is_init"], level["torchrl_is_init"])
        assert torch.equal(level["episode_reward"], level["torchrl_sum"])


def test_collectors_may_limit_episodes_in_place_of_the_stack(make: MakeEnv) -> None:
    env = make(num_envs=2, drop=["step_limit", "low_reward"])
    policy = load_policy("straight")
    collector = Collector(env, policy, frames_per_batch=12, max_frames_per_traj=3)
    data = next(iter(collector))
    collector.shutdown()
    assert data["next", "truncated"][..., 0].tolist() == 2 * [2 * [False, False, True]]


@pytest.mark.parametrize("how", [pickle.dumps, copy.deepcopy, copy.copy])
@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_copies_are_refused_with_an_alternative(make: MakeEnv, backend: str, how: Any) -> None:
    env = make(backend, num_envs=2)
    for thing in (env, env.base_env):
        with pytest.raises(ConfigurationError, match=r"partial\(aslip.make_env, num_envs=2\)"):
            how(thing)


@pytest.mark.parametrize("several", [SerialEnv, pytest.param(ParallelEnv, marks=pytest.mark.slow)])
def test_torchrl_makes_several_environments_from_a_function(several: Any) -> None:
    env = several(2, partial(make_env, num_envs=2, num_threads=1))
    try:
        walk = env.rollout(3)
        assert walk["next", "reward"].shape == (2, 2, 3, 1)
        # each draws noise of its own
        assert (walk["observation"][0] != walk["observation"][1]).any(-1).all()
    finally:
        env.close()


def test_groups_that_cannot_be_excluded_list_their_entries(make: MakeEnv) -> None:
    env = make(num_envs=2)
    with pytest.raises(ConfigurationError, match=r"the group 'sensors'.*\('sensors', ") as info:
        env.append_transform(ExcludeTransform("sensors"))
    with pytest.raises(ConfigurationError, match="the group 'truth'"):
        env.insert_transform(len(env.transforms), ExcludeTransform("observation", "truth"))
    with pytest.raises(ConfigurationError, match="the group 'truth'"):
        make(stack={**default_stack(), "slim": ExcludeTransform("truth")})
    advice = str(info.value).partition("exclude its entries: ")[2]
    env.append_transform(eval(advice))
    check_env_specs(env)
    assert not env.rollout(2)["sensors"].keys()


def test_frame_skip_is_refused(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match="clock and estimator by one"):
        make().append_transform(FrameSkipTransform(2))
    with pytest.raises(ConfigurationError, match="clock and estimator by one"):
        make(stack={**default_stack(), "skip": FrameSkipTransform(2)})
