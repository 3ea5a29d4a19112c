"""What all collectors are to a training."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, Self

from tensordict import TensorDict

SETTINGS: Final[Mapping[str, Any]] = MappingProxyType(
    {"trust_policy": True, "auto_register_policy_transforms": False}
)
"""Of all of TorchRL's collectors."""


class SampleCollector(ABC):
    """Batches of samples, on and on; a context that ends with `shutdown`."""

    @abstractmethod
    def __iter__(self) -> Iterator[TensorDict]:
        """Batches (num_envs, T), each by the actor as it is when the batch is asked for.

        Raises:
            CollectorError: a process or an actor that collects was lost.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What to go on from, between batches."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned, before the first batch."""

    @abstractmethod
    def shutdown(self) -> None:
        """End all simulations and processes; once or more often."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()
