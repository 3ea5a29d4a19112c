"""Small transitions with only the entries that an algorithm reads."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torchrl.data import Composite

from aslip.transforms.base import SeededTransform

HIDDEN = "_hidden"
"""Group of the hidden entries. As its name begins with an underscore, TorchRL's collectors carry it
from step to step but leave it out of their batches."""


class KeepKeys(SeededTransform):
    """Hide all entries but the named ones in the group `_hidden`; must be the last transform.

    The next step puts the hidden entries back for the other transforms. An entry that the caller
    has written since then replaces the hidden one.

    Args:
        keep: entries or groups that stay visible.
    """

    def __init__(self, keep: Iterable[NestedKey]) -> None:
        super().__init__(in_keys=[], out_keys=[HIDDEN])
        self.keep = [unravel_key(key) for key in keep]
        kept = [key if isinstance(key, tuple) else (key,) for key in self.keep]
        self._kept = set(kept)
        # groups of which a part is kept
        self._opened = {key[:depth] for key in kept for depth in range(len(key))}
        # entries of the environment; those of the policy, such as its memory, are not hidden
        self._to_hide: list[tuple[str, ...]] | None = None

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        hidden = tensordict.get(HIDDEN, None)
        return tensordict if hidden is None else _fill(tensordict, hidden)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        hidden = TensorDict(batch_size=next_tensordict.batch_size)
        keys = self._to_hide
        for key in self._hidden_keys(next_tensordict, ()) if keys is None else keys:
            hidden.set(key, next_tensordict.pop(key))
        return next_tensordict.set(HIDDEN, hidden)

    def _hidden_keys(
        self, entries: TensorDictBase | Composite, above: tuple[str, ...]
    ) -> list[tuple[str, ...]]:
        """Smallest set of keys that covers all entries to hide."""
        keys = []
        for name in map(str, entries.keys()):
            key = (*above, name)
            if key in self._opened:
                keys += self._hidden_keys(entries[name], key)
            elif key not in self._kept and name not in _FLAGS:
                keys.append(key)
        return keys

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Move the specs of the hidden entries to their group."""
        hidden = Composite(shape=observation_spec.shape)
        self._to_hide = self._hidden_keys(observation_spec, ())
        for key in self._to_hide:
            hidden[key] = observation_spec[key]
            del observation_spec[key]
        observation_spec[HIDDEN] = hidden
        return observation_spec


# entries of the environment that are not observations
_FLAGS = frozenset({"reward", "done", "terminated", "truncated"})


def _fill(tensordict: TensorDictBase, hidden: TensorDictBase) -> TensorDictBase:
    """Add hidden entries to a tensordict, except those that it has."""
    for name, value in hidden.items():
        present = tensordict.get(name, None)
        if present is None:
            tensordict.set(name, value)
        elif isinstance(present, TensorDictBase):
            _fill(present, cast("TensorDictBase", value))
    return tensordict
