"""Stack whose policy observes its last action, with rewards for heading and landing."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import aslip
from aslip.envs import (
    EPISODE_ENDS,
    StackEnv,
    evaluation_stack,
    policy_interface,
    precise_stack,
    standing_stack,
)
from aslip.policy.symmetry import observation_mirror
from aslip.transforms import DIRECTION_TABLE, PRECISE_TABLE, rewards
from aslip.transforms.rewards import DIRECTION_WEIGHTS, PRECISE_WEIGHTS
from tests.library.standing import standing_library


def make(stack: dict, num: int = 2) -> StackEnv:
    return aslip.make_env(
        stack=stack, num_envs=num, num_threads=1, drop=(*EPISODE_ENDS, "fall", "noise")
    )


@pytest.fixture(scope="module")
def env() -> StackEnv:
    return make(precise_stack(standing_library()))


def test_the_last_action_is_the_end_of_the_observation(env: StackEnv) -> None:
    check_env_specs(env)
    td = env.reset()
    assert policy_interface(env)["stack"] == "precise"
    assert PRECISE_TABLE[:-1] == DIRECTION_TABLE
    assert td["observation"].shape == (2, 82)
    assert not td["observation"][:, 72:].any()
    for _ in range(2):
        action = 0.1 * torch.randn(2, 10)
        td["action"] = action
        td = env.step(td)["next"]
        assert torch.equal(td["observation"][:, 72:], action)
    assert len(observation_mirror(PRECISE_TABLE).index) == 82


def test_rewards_read_the_estimated_heading_and_the_largest_force(env: StackEnv) -> None:
    assert sum(PRECISE_WEIGHTS.values()) == pytest.approx(1.0)
    before = env.reset(TensorDict(command=torch.tensor([[0.1, 0.0, 0.1]] * 2), batch_size=2))
    for _ in range(3):
        goal = cast("Tensor", before["goal", "body_heading"])
        before["action"] = torch.zeros(2, 10)
        td = env.step(before)["next"]
        terms = td["reward_terms"]
        assert {*terms.keys()} == {*PRECISE_WEIGHTS}
        orientation = cast("Tensor", td["odometry", "pelvis_orientation"])
        assert torch.equal(terms["heading_diff"], rewards.heading_diff(orientation, goal))
        largest = cast("Tensor", td["truth", "largest_force"])
        assert torch.equal(terms["landing"], rewards.landing(largest).float())
        expected = sum(PRECISE_WEIGHTS[name] * term for name, term in terms.items())
        torch.testing.assert_close(td["reward"], expected)
        before = td


def test_evaluations_have_the_rewards_of_all_experiments() -> None:
    library = standing_library()
    ends = [
        make(evaluation_stack(stack(library), library)) for stack in (standing_stack, precise_stack)
    ]
    tds = [env.reset(TensorDict(phase=torch.full((2, 1), 0.3), batch_size=2)) for env in ends]
    tds[1]["command"], tds[1]["stand"] = tds[0]["command"], tds[0]["stand"]
    assert [td["observation"].shape[1] for td in tds] == [72, 82]
    for i, env in enumerate(ends):
        tds[i]["action"] = torch.zeros(2, 10)
        tds[i] = env.step(tds[i])["next"]
        assert {*tds[i]["reward_terms"].keys()} == {*DIRECTION_WEIGHTS}
