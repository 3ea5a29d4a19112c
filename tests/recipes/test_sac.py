"""Soft actor-critic: bounded actions, a small buffer, and a policy that can be loaded."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

import aslip
from aslip.errors import ConfigurationError
from aslip.training.progress import read_progress
from recipes import sac_aslip


def test_sac_trains_a_policy_that_loads_with_its_network(tmp_path: Path) -> None:
    config = sac_aslip.Config(tmp_path, total_steps=48, num_envs=8, samples=16, updates=2)
    rewards = sac_aslip.main(config)
    assert len(rewards) == 3
    assert all(math.isfinite(reward) for reward in rewards)
    assert read_progress(tmp_path)["step"] == [16, 32, 48]
    with pytest.raises(ConfigurationError, match=r"made by 'recipes\.sac_aslip\.make_actor'"):
        aslip.load_policy(tmp_path)
    policy = aslip.load_policy(tmp_path, sac_aslip.make_actor)
    action = policy(TensorDict(observation=100 * torch.randn(50, 64), batch_size=50))["action"]
    assert 0.3 < action.abs().max() <= 0.5
