"""Running normaliser: statistics, constant inputs."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

import aslip
from aslip.policy import RunningNormalizer
from tests.policy.inputs import random_observations


def test_normalizer_statistics_equal_numpy() -> None:
    normalizer = RunningNormalizer(64)
    batches = [random_observations(num, seed) for seed, num in enumerate((1, 7, 500, 2, 64))]
    for batch in batches:
        normalizer.update(batch)
    everything = torch.cat(batches).double().numpy()
    assert (normalizer.count == len(everything)).all()
    np.testing.assert_allclose(normalizer.mean, everything.mean(axis=0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(normalizer.variance, everything.var(axis=0), rtol=1e-9)
    normalised = normalizer(torch.cat(batches)).numpy()
    expected = (everything - everything.mean(axis=0)) / everything.std(axis=0)
    np.testing.assert_allclose(normalised, expected.clip(-10, 10), atol=0.01)


def test_constant_input_is_not_scaled() -> None:
    normalizer = RunningNormalizer(2)
    values = torch.stack([torch.full((1000,), 0.95), torch.randn(1000)], dim=-1)
    normalizer.update(values)
    moved = normalizer(values + torch.tensor([1e-3, 0.0])) - normalizer(values)
    assert moved.abs().max() < 1.1e-3
    loaded = RunningNormalizer(2)
    loaded.load_state_dict(normalizer.state_dict())
    torch.testing.assert_close(loaded(values), normalizer(values), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("name", "constant"), [("straight", [56, 62]), ("robust", [56, 62]), ("single_reference", [])]
)
def test_action_is_insensitive_to_entry_constant_in_training(
    name: str, constant: list[int]
) -> None:
    """A reference whose feet move sideways by 1 mm/s must not turn the actions of a policy."""
    policy = aslip.load_policy(name)
    normalizer = next(m for m in policy.modules() if isinstance(m, RunningNormalizer))
    assert (normalizer.variance < 1e-8).nonzero()[:, 0].tolist() == constant
    observation = normalizer.mean.float().repeat(1 + len(constant), 1)
    for row, entry in enumerate(constant, 1):
        observation[row, entry] += 1e-3
    action = policy(TensorDict(observation=observation, batch_size=len(observation)))["action"]
    assert ((action - action[0]).abs() < 1e-2).all()
