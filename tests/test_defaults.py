"""Other defaults of torch, which another library of the same program may set, change nothing."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

import aslip
from aslip.envs import BatchEnv
from aslip.network.runner.load import standing_estimate
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    add_memory,
    make_critic,
    make_recurrent_actor,
    save_policy,
)
from aslip.walking import Walker, evaluate
from recipes import ppo_aslip
from tests.helpers import TINY, leaves

Found = dict[str, torch.Tensor]


def rollouts(folder: Path) -> Found:
    """Three policy steps of two shipped policies, each in its stack."""
    found: Found = {}
    for name, stack in (("single_reference", "single_reference"), ("directions", "directions")):
        with closing(aslip.make_env(stack=stack, num_envs=2, num_threads=1, seed=0)) as env:
            rows = env.rollout(3, aslip.load_policy(name))
        found |= {f"{name} {key}": value for key, value in leaves(rows).items()}
    return found


def controllers(folder: Path) -> Found:
    """Motor targets from packets, lost packets and estimates."""
    found, packets = {}, BatchEnv(2, num_threads=1).reset()["sensors"]
    controller = aslip.Controller("directions")
    for kind, given in (("packets", packets), ("estimates", standing_estimate())):
        state = controller.start(given, 0.5, stand=True)
        state, _ = controller.step(state, None, 0.4, heading=0.1, stand=False)
        found[kind] = controller.step(state, given)[1]
    return found


def walks(folder: Path) -> Found:
    """Evaluation, a walk of `Walker`, and steps by the interface of Gymnasium."""
    with closing(aslip.make_env(num_envs=2, num_threads=1, seed=0)) as env:
        results = evaluate(aslip.load_policy("straight"), env, [0.5, 1.0], 3)
    walker = Walker(seed=0)
    walker.command, walker.stand = (0.3, 0.0, 0.1), True
    walker.push((1.0, 2.0, 3.0))
    walker.step()
    gym = aslip.GymEnv(seed=0, num_threads=1)
    gym.reset(options={"command": 1.0})
    observed = gym.step(np.zeros(10))[0]
    totals = torch.from_numpy(np.array([result.total for result in results]))
    return {
        "evaluation": totals,
        "walker": walker.td["observation"],
        "gym": torch.from_numpy(observed),
    }


def networks(folder: Path) -> Found:
    """Weights, files and memory of a recurrent policy."""
    shape, normalizer = PolicyShape(hidden=(8,)), RunningNormalizer(64)
    actor = make_recurrent_actor(normalizer, shape)
    save_policy(folder / "policy.zip", actor, shape, network=make_recurrent_actor)
    loaded = aslip.load_policy(folder / "policy.zip")
    with closing(add_memory(aslip.make_env(num_threads=1, seed=0), loaded)) as env:
        rows = leaves(env.rollout(2, loaded))
    critic = make_critic(normalizer, shape).state_dict()
    return {**loaded.state_dict(), **critic, **{str(key): value for key, value in rows.items()}}


def training(folder: Path) -> Found:
    """Policy after two updates of PPO."""
    with mock.patch("recipes.ppo_aslip.save_results"):
        ppo_aslip.main(replace(TINY, out=folder))
    return aslip.load_policy(folder).state_dict()


PARTS = (rollouts, controllers, walks, networks, training)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    """Entries that each part gives under the usual defaults."""
    return {part.__name__: seeded(part, tmp_path_factory.mktemp("usual")) for part in PARTS}


def seeded(part: Callable[[Path], Found], folder: Path) -> Found:
    torch.manual_seed(0)
    return part(folder)


@pytest.fixture
def other_defaults() -> Iterator[None]:
    """Other defaults; tensors of the device "meta" have no numbers, so any use of one fails."""
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    yield
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)


@pytest.mark.parametrize("part", PARTS)
def test_results_do_not_depend_on_the_defaults_of_torch(
    part: Callable[[Path], Found], expected: dict[str, Found], other_defaults: None, tmp_path: Path
) -> None:
    found = seeded(part, tmp_path)
    assert found.keys() == expected[part.__name__].keys()
    for name, value in expected[part.__name__].items():
        assert (found[name].dtype, found[name].device) == (value.dtype, value.device), name
        np.testing.assert_array_equal(found[name].numpy(), value.numpy(), err_msg=name)
