"""A stopped and resumed training equals an uninterrupted one bit for bit."""

import math
import os
import signal
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import GlobalRNGState
from torchrl.collectors import Collector
from torchrl.envs.transforms import Compose, Transform

import aslip
from aslip.envs import (
    BatchEnv,
    SimulatedEnv,
    Stack,
    StackEnv,
    default_stack,
    insert_before,
    randomise_stack,
)
from aslip.errors import ConfigurationError, ShapeError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, read_card
from aslip.training.checkpoint import CollectorState, load_checkpoint, save_checkpoint, snapshot
from aslip.training.collectors import LocalCollector
from aslip.training.progress import read_progress
from aslip.transforms import Difficulty, ObservationNoise, RandomDynamics, RandomPushes
from recipes import ppo_aslip
from tests.helpers import MakeEnv, differing, identical
from tests.training.trainings import (
    TINY,
    Holder,
    count_updates,
    kill_training,
    resume_training,
    train,
)

ROBOTS, STEPS = 4, 8


def _harder(stack: Stack) -> Stack:
    """Stack with pushes, and with robots that become more different."""
    key = "difficulty"
    stack |= {"dynamics": RandomDynamics(difficulty_key=key)}
    difficulty, pushes = Difficulty(30), RandomPushes(40.0, 0.3, difficulty_key=key)
    return insert_before(stack, "command", difficulty=difficulty, pushes=pushes)


STACKS: dict[str, Callable[[], dict[str, Any]]] = {
    "single_reference": lambda: {"stack": "single_reference"},
    "random robots": lambda: {"stack": _harder(randomise_stack(default_stack()))},
    "compose": lambda: {"replace": {"noise": Compose(ObservationNoise())}},  # pyright: ignore[reportArgumentType]
    "dm_control": lambda: {"backend": "dm_control"},
}


def _collector(make: MakeEnv, seed: int = 0, **settings: Any) -> Collector:
    """Collector with a random policy, which soon falls."""
    torch.manual_seed(seed)
    env = make(num_envs=ROBOTS, seed=seed, **settings)
    size = env.observation_spec["observation"].shape[-1]
    return Collector(
        env,
        make_actor(RunningNormalizer(size), PolicyShape(size, std=1.0)),
        frames_per_batch=ROBOTS * STEPS,
        total_frames=-1,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )


def _components(collector: Collector) -> dict[str, Any]:
    return {"rng": GlobalRNGState(), "collector": CollectorState(collector)}


def _robots(collector: Collector) -> SimulatedEnv:
    return cast("SimulatedEnv", collector.env.base_env)


def _batches(collector: Collector, number: int) -> list[TensorDictBase]:
    return [batch for batch, _ in zip(collector, range(number), strict=False)]


# -------------------------------------------------------------------- collectors


@pytest.mark.parametrize("name", STACKS)
def test_a_collector_resumes_bit_for_bit(make: MakeEnv, tmp_path: Path, name: str) -> None:
    """From a file, in an environment with another seed and other past steps; robots fall."""
    path, first = tmp_path / "checkpoint", _collector(make, **STACKS[name]())
    _batches(first, 2)
    _robots(first).divergences += 3
    save_checkpoint(path, snapshot(_components(first)), {})
    expected = _batches(first, 2)
    assert all(batch["next", "done"].any() for batch in expected)

    second = _collector(make, seed=1, **STACKS[name]())
    _batches(second, 1)
    load_checkpoint(path, _components(second))
    for batch, again in zip(expected, _batches(second, 2), strict=True):
        assert differing(batch, again) == []
    assert _robots(second).divergences == _robots(first).divergences


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    """State of a collector after two batches, as a dict of its parts."""
    collector = _collector(partial(aslip.make_env, num_threads=1))
    _batches(collector, 2)
    return snapshot(_components(collector))["collector"]


def test_every_part_of_the_state_matters(make: MakeEnv, parts: dict[str, Any]) -> None:
    """The next batch differs if a part comes from another collector."""
    first, other = _collector(make), _collector(make, seed=1)
    _batches(other, 1)
    foreign = snapshot(_components(other))["collector"]

    def batch_after(state: dict[str, Any]) -> TensorDictBase:
        torch.manual_seed(0)
        CollectorState(first).load_state_dict(deepcopy(state))
        return _batches(first, 1)[0]

    expected = batch_after(parts)
    for name in ("torchrl", "carrier", "robots", "generators"):
        assert differing(expected, batch_after({**parts, name: foreign[name]})), name
    # otherwise the collector's own steps made the difference
    assert differing(expected, batch_after(parts)) == []


def test_robots_keep_their_dynamics(make: MakeEnv) -> None:
    """Even if an earlier, longer delay has lengthened the memory of commands."""
    given = {"mass": 1.2, "slope": 0.05, "torque_delay": 0.004}
    first = _collector(make)
    for values in ({"torque_delay": 0.02}, given):
        _robots(first).set_dynamics(values, np.array([1, 3]))
    _batches(first, 1)
    kept = snapshot(_components(first))
    expected = _batches(first, 1)[0]
    second = _collector(make, seed=1)
    for name, component in _components(second).items():
        component.load_state_dict(kept[name])
    for name, values in _robots(first).dynamics.items():
        assert _robots(second).dynamics[name].tolist() == values.tolist()
    assert differing(expected, _batches(second, 1)[0]) == []


def test_the_state_of_another_environment_is_refused(make: MakeEnv, parts: dict[str, Any]) -> None:
    state = CollectorState(_collector(make, drop=["noise"]))
    with pytest.raises(ConfigurationError, match=r"another stack.*noise"):
        state.load_state_dict(parts)
    robots = {**parts["robots"], "dynamics": {}, "states": parts["robots"]["states"][:1]}
    with pytest.raises(ShapeError, match=r"shape \(4, 600\), got \(1, 600\)"):
        CollectorState(_collector(make)).load_state_dict({**parts, "robots": robots})


# ------------------------------------------------------------------------- files


def test_a_state_survives_writing_and_reading(tmp_path: Path) -> None:
    """Types and bits are kept: NaN, number keys, nested tuples, empty containers."""
    state = {
        "numbers": [1, 2.5, 1e-300, -0.0, True, None, "text", 10**30],
        "nested": ({3: (), "x": [(1,), {}]},),
        "tensors": {
            "double": torch.tensor([1 / 3, -0.0, float("inf")], dtype=torch.float64),
            "scalar": torch.tensor(7, dtype=torch.int32),
            "flags": torch.tensor([[True], [False]]),
            "bytes": torch.arange(5, dtype=torch.uint8),
            "none": torch.zeros(0, 3),
        },
    }
    holder = Holder()
    save_checkpoint(tmp_path / "file", {"state": state, "empty": {}}, {"step": 3})
    assert load_checkpoint(tmp_path / "file", {"state": holder}) == {"step": 3}
    assert identical(holder.state, state)
    assert type(holder.state["nested"]) is tuple


# --------------------------------------------------------------------- trainings


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Files of an uninterrupted training."""
    return train(replace(TINY, out=tmp_path_factory.mktemp("runs") / "undisturbed"))


def test_a_training_killed_at_a_random_time_resumes(
    undisturbed: dict[str, Any], tmp_path: Path
) -> None:
    """SIGKILL, which cannot be caught, at some time in the first half."""
    config = replace(TINY, out=tmp_path / "run")
    entropy = int.from_bytes(os.urandom(2), "little")
    kill_training(config.out, entropy % 4, 0.3 * entropy / 2**16)
    before = count_updates(config.out)
    assert resume_training(config) == undisturbed, f"killed by {entropy} after {before} updates"


def test_a_training_stopped_during_an_update_resumes(
    undisturbed: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It resumes from the previous update: partly updated networks are discarded."""
    config = replace(TINY, out=tmp_path / "run", checkpoint_minutes=1e6)
    update, left = ppo_aslip.update, [5]

    def stopped(*args: Any) -> Any:
        losses = update(*args)
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGTERM)
        return losses

    with monkeypatch.context() as patch:
        patch.setattr(ppo_aslip, "update", stopped)
        with pytest.raises(SystemExit) as info:
            train(config)
        assert info.value.code == 128 + signal.SIGTERM
    newest = max((config.out / "checkpoints").iterdir())
    assert newest.name == "checkpoint-000000000256.zip"
    kept, policy = Holder(), aslip.load_policy(config.out).state_dict()
    load_checkpoint(newest, {"actor": kept})
    assert read_card(config.out)["made_by"]["steps"] == 256
    assert all(torch.equal(policy[name], kept.state[name]) for name in policy)
    assert resume_training(config) == undisturbed


@pytest.fixture(scope="module")
def two_updates(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[ppo_aslip.Config, dict[str, Any]]:
    """Settings and files of a training of two updates, each with an evaluation."""
    folder = tmp_path_factory.mktemp("runs") / "two"
    config = replace(TINY, out=folder, total_steps=128, eval_interval=64)
    return config, train(config)


def test_resuming_a_finished_training_changes_nothing(
    two_updates: tuple[ppo_aslip.Config, dict[str, Any]],
) -> None:
    """Every evaluation has the same noise."""
    config, before = two_updates
    summary = (config.out / "summary.md").read_text().rpartition("\n\n")[0]
    assert "of 21 speeds" in summary
    assert resume_training(config) == before
    assert (config.out / "summary.md").read_text().rpartition("\n\n")[0] == summary


class Spoiling(Transform):
    """Put NaN into one robot's state at three policy steps."""

    def __init__(self) -> None:
        super().__init__()
        self._taken = 0

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        self._taken += 1
        base: Any = self.parent
        while not isinstance(base, BatchEnv):
            base = base.base_env
        if self._taken in (8, 12, 19):
            states = base.states()
            states[self._taken % base.num_envs, 3] = math.nan
            base.set_states(states)
        return next_tensordict


def _spoiled_collector(make_env: Any, actor: Any, **settings: Any) -> LocalCollector:
    def make(**keywords: Any) -> StackEnv:
        env = make_env(**keywords)
        env.append_transform(Spoiling())
        return env

    return LocalCollector(make, actor, **settings)


def test_training_continues_after_divergence(tmp_path: Path) -> None:
    """Three NaN states of one robot cause three divergences, and all numbers stay finite."""
    config = replace(TINY, out=tmp_path / "run", total_steps=128)
    train(config, make_collector=_spoiled_collector)
    progress = read_progress(config.out)
    assert progress["divergences"] == [2, 3]
    for name, column in progress.items():
        assert "eval" in name or all(map(math.isfinite, column)), name
