"""Samples from robots in this process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import Any, Final, cast

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.collectors import Collector

from aslip.errors import ConfigurationError
from aslip.policy import add_memory
from aslip.training.checkpoint import CollectorState
from aslip.training.environments import MakeEnv

TORCHRL_SETTINGS: Final[Mapping[str, Any]] = MappingProxyType(
    {"trust_policy": True, "auto_register_policy_transforms": False}
)
"""Settings common to all collectors of TorchRL."""


class LocalCollector(AbstractContextManager[Any]):
    """Collector of batches (num_envs, T), time last, that resumes bit for bit.

    The actor's weights at the time of the request collect the whole batch. As a context manager,
    it calls `shutdown` at the end.

    Args:
        make_env: makes the environment.
        actor: the policy.
        num_envs: number of robots.
        samples: total number of policy steps of a batch.
        seed: seed of the environment, by default its own; actions use torch's global generator.
        device: device of the actor and the batches.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        actor: nn.Module,
        *,
        num_envs: int,
        samples: int,
        seed: int | None = None,
        device: str | torch.device = "cpu",
    ) -> None:
        env = add_memory(make_env(num_envs=num_envs, seed=seed), actor)
        devices = {}
        if torch.device(device).type != "cpu" and env.place.type == "cpu":
            devices = {"policy_device": device, "storing_device": device, "env_device": "cpu"}
        self._collector = Collector(
            env, actor, frames_per_batch=samples, total_frames=-1, **devices, **TORCHRL_SETTINGS
        )
        self._state = CollectorState(self._collector)

    def __iter__(self) -> Iterator[TensorDict]:
        return cast("Iterator[TensorDict]", iter(self._collector))

    def state_dict(self) -> dict[str, Any]:
        """State of all simulations, see `CollectorState`."""
        return self._state.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from what `state_dict` returned.

        Raises:
            ConfigurationError: the state comes from a different environment, or `RayCollectors`.
        """
        if "robots" not in state:
            raise ConfigurationError(
                "the training had its robots in Ray actors; give it num_collectors to resume"
            )
        self._state.load_state_dict(state)

    def shutdown(self) -> None:
        """Close the environment."""
        self._collector.shutdown()

    def __exit__(self, *exception: object) -> None:
        self.shutdown()
