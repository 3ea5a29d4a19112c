"""Collectors by kind."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import get_args

from torch import nn

from aslip.envs import StackEnv
from aslip.errors import ConfigurationError
from aslip.training.collect.base import SampleCollector
from aslip.training.collect.distributed import DistributedCollectors
from aslip.training.collect.local import LocalCollector
from aslip.training.collect.ray import RayCollectors
from aslip.training.settings import CollectorKind, check_shares


def make_collector(
    make_env: Callable[..., StackEnv],
    actor: nn.Module,
    *,
    kind: CollectorKind = "single",
    num_envs: int,
    samples: int,
    num_collectors: int = 2,
    seed: int = 0,
) -> SampleCollector:
    """What yields batches of samples that the actor took, on and on.

    Args:
        make_env: of keywords `num_envs`, `seed` and `num_threads`, as `aslip.make_env`; must be
            possible to pickle with cloudpickle, unless for `single`.
        actor: the policy, in this process.
        kind: where robots are, see `aslip.training.collect`.
        num_envs: robots, of all collectors together.
        samples: policy steps of a batch, of all robots together.
        num_collectors: processes or actors to share robots out to, unless for `single`.
        seed: of their environments and actions; those of `single` have the seed of `make_env`, and
            torch's.

    Raises:
        ConfigurationError: unknown kind; Ray is not installed; or robots and samples cannot be
            shared out equally.
    """
    if kind not in get_args(CollectorKind):
        kinds = get_args(CollectorKind)
        raise ConfigurationError(f"collector must be one of {kinds}, got {kind!r}")
    if kind == "single":
        return LocalCollector(make_env(num_envs=num_envs), actor, samples)
    check_shares(num_envs, samples, num_collectors)
    if kind == "ray" and importlib.util.find_spec("ray") is None:
        raise ConfigurationError("the collector 'ray' needs Ray: pip install 'aslip[ray]'")
    remote = DistributedCollectors if kind == "distributed" else RayCollectors
    return remote(make_env, actor, num_envs, samples, num_collectors, seed)
