"""Recurrent policies: memory within an episode, none across, and files that rebuild them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.modules import set_recurrent_mode

import aslip
from aslip.errors import ConfigurationError
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    add_memory,
    make_recurrent_actor,
    read_card,
    save_policy,
)
from aslip.walking import record_walks
from aslip.walking.evaluation import evaluate
from aslip.walking.walker import Walker
from tests.helpers import MakeEnv

SHAPE = PolicyShape(hidden=(16, 8), std=1.0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    actor = make_recurrent_actor(RunningNormalizer(64), SHAPE)
    with torch.no_grad():  # actions well away from zero
        for parameter in actor.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    save_policy(tmp_path / "policy.zip", actor, SHAPE, network=make_recurrent_actor)
    return tmp_path / "policy.zip"


def test_hidden_state_lasts_one_episode(make: MakeEnv, file: Path) -> None:
    policy = aslip.load_policy(file)
    assert read_card(file)["network"] == "gru"
    env = add_memory(make(num_envs=3), policy)
    names = env.transform_names
    assert add_memory(env, policy).transform_names == names
    data = env.rollout(30, policy.requires_grad_(False), break_when_any_done=False)
    first = data["is_init"][..., 0]
    assert first[:, 1:].any()
    kept = data["next", "memory"][:, :-1]
    following = data["memory"][:, 1:]
    assert torch.equal(following[~first[:, 1:]], kept[~first[:, 1:]])
    alone = data[:, 5:6].exclude("memory", "action", "loc").clone()
    alone["is_init"] = torch.ones_like(alone["is_init"])
    assert not torch.allclose(policy(alone[:, 0])["loc"], data["loc"][:, 5])
    # a sequence in one pass, resets in the middle, as losses evaluate it
    with set_recurrent_mode(True):
        again = policy(data.exclude("action", "loc", "features", "next").clone())
    torch.testing.assert_close(again["loc"], data["loc"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("settings", [{}, {"keep": ["observation"]}])
def test_a_recurrent_policy_refuses_an_environment_that_drops_its_memory(
    make: MakeEnv, file: Path, settings: dict[str, Any]
) -> None:
    env, policy = make(num_envs=2, **settings), aslip.load_policy(file)
    with pytest.raises(
        ConfigurationError, match=r"drops its hidden state.*add_memory\(env, policy\)"
    ):
        env.rollout(2, policy)
    assert "memory" in add_memory(env, policy).rollout(2, policy)


def test_recurrent_policy_walks_and_evaluates(make: MakeEnv, file: Path) -> None:
    walker = Walker(file, seed=0)
    found = [walker.step()["action"].clone() for _ in range(4)]
    policy = aslip.load_policy(file)
    walks = record_walks(policy, make(drop=["low_reward", "step_limit"]), np.zeros((4, 1)))
    np.testing.assert_allclose(torch.cat(found), walks.action[:, 0], rtol=0, atol=0)
    (result,) = evaluate(policy, make(), [0.0], num_steps=4)
    assert result.steps == 4


def test_a_walk_goes_on_with_a_recurrent_policy_without_memory(file: Path) -> None:
    walker = Walker("straight", seed=0)
    walker.step()
    walker.policy = file
    first = walker.td.clone()
    assert not first["memory"].any()
    assert first["is_init"].all()
    action = walker.step()["action"].clone()
    walker.step()
    walker.td, walker.policy = first, file
    torch.testing.assert_close(walker.step()["action"], action, rtol=0, atol=0)


def test_add_memory_refuses_the_memory_of_another_policy(make: MakeEnv) -> None:
    small, large = (
        make_recurrent_actor(RunningNormalizer(64), PolicyShape(hidden=hidden))
        for hidden in ((8,), (16,))
    )
    env = add_memory(make(), small)
    with pytest.raises(ConfigurationError, match=r"'memory' has shape \(1, 16\).*\(1, 8\)"):
        add_memory(env, large)


@pytest.mark.parametrize("shape", [PolicyShape(symmetric=True), PolicyShape(hidden=())])
def test_recurrent_actor_refuses_symmetry_and_no_hidden_layer(shape: PolicyShape) -> None:
    with pytest.raises(ConfigurationError, match="recurrent policy"):
        make_recurrent_actor(RunningNormalizer(64), shape)
