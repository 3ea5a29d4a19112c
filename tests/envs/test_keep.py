"""Transitions with only the entries that an algorithm reads."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs.utils import check_env_specs

from aslip.errors import UnknownNameError
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    add_memory,
    make_recurrent_actor,
    policy_interface,
)
from tests.helpers import MakeEnv, differing, leaves

KEEP = ["observation", ("reward_terms", "com_vel")]


def _policy() -> TensorDictModule:
    """Policy whose actions make robots fall at different times."""
    waves = torch.arange(10)
    return TensorDictModule(
        lambda observation: 0.3 * torch.sin(waves * observation.sum(-1, keepdim=True)),
        in_keys=["observation"],
        out_keys=["action"],
    )


def _collect(make: MakeEnv, keep: list | None) -> TensorDictBase:
    env = make(num_envs=4, seed=3, keep=keep)
    collector = Collector(env, _policy(), frames_per_batch=100, total_frames=100)
    return next(iter(collector)).clone()


def _bytes(data: TensorDictBase) -> float:
    return sum(v.numel() * v.element_size() for v in leaves(data).values()) / data.numel()


def test_kept_entries_of_batches_have_the_same_numbers(make: MakeEnv) -> None:
    everything, kept = _collect(make, None), _collect(make, KEEP)
    # falls among them, after which some robots are reset
    assert kept["next", "done"].any() and not kept["next", "done"].all()
    assert ("next", "reward_terms", "com_vel") in leaves(kept)
    assert ("next", "reward_terms", "foot_pos") not in leaves(kept)
    assert not differing(kept, everything.select(*kept.keys(True, True)))
    assert _bytes(everything) > 9_000
    assert _bytes(kept) < 650


def test_hidden_entries_reach_the_next_step_of_a_rollout(make: MakeEnv) -> None:
    check_env_specs(make(num_envs=2, keep="observation"))
    everything = make(num_envs=2).rollout(12, _policy(), break_when_any_done=False)
    kept = make(num_envs=2, keep="observation").rollout(12, _policy(), break_when_any_done=False)
    assert torch.equal(kept["next", "observation"], everything["next", "observation"])
    assert kept["next", "_hidden", "truth"].keys() == everything["next", "truth"].keys()
    hidden = kept["_hidden"]
    assert not differing(hidden, everything.select(*hidden.keys(True, True)))


def test_commands_are_kept_and_hidden_entries_may_be_written(make: MakeEnv) -> None:
    env = make(num_envs=1, keep=["observation"])
    td = env.reset(TensorDict(command=torch.tensor([[1.3]]), batch_size=1))
    assert td["command"].item() == pytest.approx(1.3)
    td["command"] = torch.tensor([[0.6]])
    td["last_action"] = torch.ones(1, 10)
    td = env.step(td.set("action", torch.ones(1, 10)))["next"]
    assert td["command"].item() == pytest.approx(0.6)
    assert td["_hidden", "reward_terms", "action_diff"].item() == pytest.approx(1.0)


def test_hidden_entries_keep_the_interface_to_policies(make: MakeEnv) -> None:
    assert policy_interface(make(keep=["observation"])) == policy_interface(make())


def test_a_recurrent_policy_keeps_its_memory(make: MakeEnv) -> None:
    actor = make_recurrent_actor(RunningNormalizer(64), PolicyShape(hidden=(8,)))
    envs = [add_memory(make(num_envs=2, keep=keep), actor) for keep in (None, ["observation"])]
    everything, kept = (env.rollout(3, actor) for env in envs)
    assert kept["memory"][:, 1:].any()
    assert torch.equal(kept["memory"], everything["memory"])


def test_unknown_entries_are_named(make: MakeEnv) -> None:
    with pytest.raises(UnknownNameError, match="observation"):
        make(keep=["observations"])
