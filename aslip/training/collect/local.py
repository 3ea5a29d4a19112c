"""Samples from robots in this process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, cast

from tensordict import TensorDict
from torch import nn
from torchrl.collectors import Collector

from aslip.envs import StackEnv
from aslip.training.checkpoint import CollectorState
from aslip.training.collect.base import SETTINGS, SampleCollector


class LocalCollector(SampleCollector):
    """Robots in this process; resumes bit for bit.

    Args:
        env: the robots.
        actor: the policy.
        samples: policy steps of a batch.
    """

    def __init__(self, env: StackEnv, actor: nn.Module, samples: int) -> None:
        self._collector = Collector(
            env, actor, frames_per_batch=samples, total_frames=-1, **SETTINGS
        )
        self._state = CollectorState(self._collector)

    def __iter__(self) -> Iterator[TensorDict]:
        return cast("Iterator[TensorDict]", iter(self._collector))

    def state_dict(self) -> dict[str, Any]:
        """The state of all simulations, see `CollectorState`."""
        return self._state.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        Raises:
            ConfigurationError: it is of another environment.
        """
        self._state.load_state_dict(state)

    def shutdown(self) -> None:
        """Close the environment."""
        self._collector.shutdown()
