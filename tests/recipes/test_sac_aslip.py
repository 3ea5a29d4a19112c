"""Soft actor-critic: bounded actions, a small buffer, and a policy that can be loaded."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded
from torchrl.objectives import SACLoss

import aslip
from aslip.errors import ConfigurationError
from aslip.policy import PolicyShape, RunningNormalizer
from aslip.training.progress import read_progress
from recipes import sac_aslip


def test_critics_of_the_loss_follow_the_normaliser() -> None:
    """Although SACLoss copies the critic's modules at construction."""
    shape, normalizer = PolicyShape(2, 1), RunningNormalizer(2)
    actor = sac_aslip.make_actor(normalizer, shape)
    spec = Bounded(-1, 1, torch.Size([1]))
    loss = SACLoss(actor, sac_aslip.make_critic(normalizer, shape), action_spec=spec)
    observation = torch.tensor([[3.0, 5.0]])
    pair = TensorDict(observation=observation, action=torch.zeros(1, 1), batch_size=1)

    def seen() -> torch.Tensor:
        with loss.qvalue_network_params.data[0].to_module(loss.qvalue_network):
            return loss.qvalue_network(pair.clone())["normalised"]

    normalizer.update(torch.tensor([[2.0, 2.0], [4.0, 8.0]]))
    torch.testing.assert_close(seen(), normalizer(observation))
    assert not torch.equal(seen(), observation)


def test_sac_trains_a_policy_that_loads_with_its_network(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    config = sac_aslip.Config(folder, total_steps=48, num_envs=8, samples=16, updates=2)
    sac_aslip.main(config)
    progress = read_progress(folder)
    assert progress["step"] == [16, 32, 48]
    with pytest.raises(ConfigurationError, match="holds a run; give another --out"):
        sac_aslip.main(config)
    assert all(0 < reward <= 1 for reward in progress["reward"])
    with pytest.raises(ConfigurationError, match=r"made by 'recipes\.sac_aslip\.make_actor'"):
        aslip.load_policy(folder)
    policy = aslip.load_policy(folder, sac_aslip.make_actor)
    observation = TensorDict(observation=100 * torch.randn(50, 64), batch_size=50)
    assert 0 < policy(observation)["action"].abs().max() < 0.4
