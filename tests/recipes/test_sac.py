"""Soft actor-critic: bounded actions, a small buffer, and a policy that can be loaded."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

import aslip
from aslip.errors import ConfigurationError
from aslip.training.progress import read_progress
from recipes import sac_aslip


def test_sac_trains_a_policy_that_loads_with_its_network(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    config = sac_aslip.Config(folder, total_steps=48, num_envs=8, samples=16, updates=2)
    sac_aslip.main(config)
    progress = read_progress(folder)
    assert progress["step"] == [16, 32, 48]
    assert all(0 < reward <= 1 for reward in progress["reward"])
    with pytest.raises(ConfigurationError, match=r"made by 'recipes\.sac_aslip\.make_actor'"):
        aslip.load_policy(folder)
    policy = aslip.load_policy(folder, sac_aslip.make_actor)
    observation = TensorDict(observation=100 * torch.randn(50, 64), batch_size=50)
    assert 0 < policy(observation)["action"].abs().max() < 0.4
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.mul_(1000)
    assert policy(observation)["action"].abs().max() == pytest.approx(0.4, abs=1e-3)
