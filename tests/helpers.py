"""Comparisons, policies and settings shared by several test modules."""

import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from aslip.envs import STACKS, BatchEnv, DmControlEnv, SimulatedEnv, StackEnv
from aslip.robot import CASSIE
from aslip.sim import PD
from aslip.transforms import SeededTransform
from recipes.ppo_settings import Config

MakeEnv = Callable[..., StackEnv]

STRAIGHT_STACKS = [name for name in STACKS if name not in ("directions", "walking", "planned")]
"""Stacks of straight walks."""

MADE_BY = {"command": "python recipes/gait_library.py", "aslip": "0.1.0"}

TINY = Config(
    num_envs=8, samples=64, total_steps=128, minibatch=32, eval_interval=1000, checkpoint_minutes=0,
    eval_steps=5,
)  # fmt: skip
"""Settings of a training of two updates."""


BACKENDS = ("batch", "dm_control")
STANDING = torch.tensor(CASSIE.standing)
"""Configuration (35,) of a robot that stands."""


def bare_env(backend: str, num_envs: int = 2) -> SimulatedEnv:
    """Environment without a stack."""
    if backend == "batch":
        return BatchEnv(num_envs, num_threads=1)
    return DmControlEnv(num_envs)


def standing_targets(env: SimulatedEnv) -> torch.Tensor:
    """Motor targets (n, 10) of standing."""
    return STANDING[env.indices.motor_qpos.copy()].float().expand(env.num_envs, 10).clone()


def seeded(transform: SeededTransform) -> Any:
    """Give a transform without an environment a seed, so that a test repeats its numbers."""
    transform.set_seed(0)
    return transform


@contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Limit the size of files [bytes]; the system refuses to write more."""
    resource = pytest.importorskip("resource")  # not on Windows
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def leaves(td: TensorDictBase) -> dict[tuple[str, ...], torch.Tensor]:
    """All tensors of a tensordict by their full keys."""
    return {
        (key,) if isinstance(key, str) else key: value
        for key, value in td.items(include_nested=True, leaves_only=True)
    }


def differing(a: TensorDictBase, b: TensorDictBase) -> list[str]:
    """Keys of entries that only one of them has, or that differ in any bit (NaN equals NaN)."""
    left, right = leaves(a), leaves(b)
    unmatched = ["/".join(key) for key in left.keys() ^ right.keys()]
    return sorted(unmatched) + sorted(
        "/".join(key)
        for key in left.keys() & right.keys()
        if left[key].dtype != right[key].dtype
        or not torch.allclose(left[key], right[key], rtol=0, atol=0, equal_nan=True)
    )


def limp() -> TensorDictModule:
    """Policy of zero actions, with which the robot falls."""
    return TensorDictModule(
        lambda observation: torch.zeros(*observation.shape[:-1], 10),
        in_keys=["observation"],
        out_keys=["action"],
    )


@contextmanager
def started(command: Sequence[str], **settings: Any) -> Iterator[subprocess.Popen[str]]:
    """Start a process whose output is read and that is killed at the end."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **settings) as process:
        try:
            yield process
        finally:
            process.kill()


def motor_torque(target: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Torque at the motor shafts of one or many robots (..., 10) under PD control [N m]."""
    shape = np.broadcast_shapes(target.shape, position.shape, velocity.shape)
    width = CASSIE.gear.size
    rows = [np.broadcast_to(x, shape).reshape(-1, width) for x in (target, position, velocity)]
    return PD(len(rows[0])).torque(*rows).reshape(shape)


def identical(a: Any, b: Any) -> bool:
    """Compare two states bit for bit."""
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(identical(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(identical, a, b))
    return a == b
