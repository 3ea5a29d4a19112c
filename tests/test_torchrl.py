"""An environment is what TorchRL's own transforms, losses and collectors take it for."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import NoopResetEnv, TargetReturn

from aslip.stack import STACKS
from tests.conftest import MakeEnv


@pytest.mark.parametrize("stack", list(STACKS))
def test_there_is_one_reward_and_terms_are_observations(make: MakeEnv, stack: str) -> None:
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


def test_the_return_still_to_come_can_be_asked_for(make: MakeEnv) -> None:
    env = TransformedEnv(make(num_envs=2), TargetReturn(10.0))
    data = env.rollout(3, lambda td: td.set("action", torch.zeros(2, 10)))
    left = 10.0 - data["next", "reward"].cumsum(1)
    torch.testing.assert_close(data["next", "target_return"], left)
