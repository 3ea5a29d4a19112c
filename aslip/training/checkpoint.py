"""Checkpoints: a resumed training equals an uninterrupted one bit for bit.

    components = {"actor": actor, "optimizer": optimizer, "collector": CollectorState(collector)}
    save_checkpoint(path, snapshot(components), {"step": 2048})
    metadata = load_checkpoint(path, components)

Guarantees:

- The state of a collector between batches, loaded into a collector with an equal environment and
  policy, gives the same next batch bit for bit.
- A checkpoint is written completely or not at all, and is on the disk when `save_checkpoint`
  returns.
- It contains JSON and arrays, no code, and all hashes are checked before anything is loaded.

Trap: state of a transform is saved only if it is in the tensordict, in buffers, or in generators
that are attributes or in dicts that are attributes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector

from aslip.base.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.envs import RobotEnv, SimulatedEnv, StackEnv
from aslip.errors import ConfigurationError
from aslip.sim.dynamics import longest_delay
from aslip.sim.parameters import DYNAMICS


class CollectorState:
    """State of a collector that determines its next batch, except for global generators.

    It consists of the current tensordict, simulations and sensors, dynamics, generators and buffers
    of transforms, the policy, and the collector's counters. Use it between batches only.

    Args:
        collector: collector in this process, with an environment of `aslip.make_env`.
    """

    def __init__(self, collector: Collector) -> None:
        self._collector = collector

    def state_dict(self) -> dict[str, Any]:
        """State; the first dimension of arrays is the robots."""
        env = self._env
        return {
            # counters, policy, and buffers of transforms
            "torchrl": self._collector.state_dict(),
            "carrier": _carrier(self._collector).to_dict(),
            "robots": _robots(env.base_env),
            "generators": {name: g.get_state() for name, g in _generators(env)},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `state_dict` returned.

        Raises:
            ConfigurationError: the state comes from a different environment.
        """
        generators = dict(_generators(self._env))
        if generators.keys() != state["generators"].keys():
            names = sorted(generators.keys() ^ state["generators"].keys())
            raise ConfigurationError(
                f"the state comes from another stack, which differs in {names}"
            )
        self._collector.load_state_dict(state["torchrl"])
        _set_robots(self._env.base_env, state["robots"])
        for name, generator in generators.items():
            generator.set_state(state["generators"][name])
        carrier = _carrier(self._collector)
        restored = TensorDict(
            state["carrier"], batch_size=carrier.batch_size, device=carrier.device
        )
        _set_carrier(self._collector, restored, state["torchrl"])

    @property
    def _env(self) -> StackEnv:
        return cast("StackEnv", self._collector.env)


def _carrier(collector: Collector) -> TensorDictBase:
    """Tensordict that the policy of a collector gets next.

    TorchRL has no public access to it, and its `state_dict` lacks it, so that resumed collectors
    begin new episodes. This function and `_set_carrier` are the only ones that use private
    attributes of TorchRL's collectors.
    """
    return collector._carrier


def _set_carrier(collector: Collector, carrier: TensorDictBase, state: Mapping[str, Any]) -> None:
    collector._carrier = carrier
    if "traj_pool" in state:
        # undo the new episode numbers that loading the state assigned
        collector._traj_pool.load_state_dict(state["traj_pool"])


def _robots(env: RobotEnv) -> dict[str, Any]:
    """States and dynamics of simulated robots; empty for other robots."""
    if not isinstance(env, SimulatedEnv):
        return {}
    return {
        "states": torch.from_numpy(env.states()),
        "dynamics": {name: torch.from_numpy(values) for name, values in env.dynamics.items()},
        # longest torque delay that the model allows [s]; it never decreases
        "memory": longest_delay(env.model),
        "divergences": int(env.divergences),
    }


def _set_robots(env: RobotEnv, robots: Mapping[str, Any]) -> None:
    """Restore the output of `_robots`; robots that are not simulated do not change.

    Raises:
        ShapeError: the state comes from other robots.
    """
    if not isinstance(env, SimulatedEnv):
        return
    if robots["memory"] > longest_delay(env.model):
        delay = min(robots["memory"], DYNAMICS["torque_delay"].high)
        env.set_dynamics({"torque_delay": delay})
    env.set_dynamics({name: values.numpy() for name, values in robots["dynamics"].items()})
    env.set_states(robots["states"].numpy())
    env.divergences = robots["divergences"]


def _generators(env: StackEnv) -> Iterator[tuple[str, torch.Generator]]:
    """Generators of the transforms, by name of the transform and path within it."""

    def among(place: str, value: Any) -> Iterator[tuple[str, torch.Generator]]:
        if isinstance(value, torch.Generator):
            yield place, value
        elif isinstance(value, Mapping):
            for key, item in value.items():
                yield from among(f"{place}/{key}", item)

    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        for number, part in enumerate(transform.modules()):  # those inside a Compose, too
            yield from among(f"{name}/{number}" if number else name, vars(part))


# ----------------------------------------------------------------------- files


def snapshot(components: Mapping[str, Any]) -> dict[str, Any]:
    """Copies of the states of components with `state_dict`, by name."""
    return {name: deepcopy(component.state_dict()) for name, component in components.items()}


FORMAT = ArchiveFormat(
    "checkpoint",
    2,
    advice="resume a training with the version of aslip that began it",
)
"""Entries: `metadata.json`, and for each state a JSON tree and its arrays."""
_METADATA = "metadata.json"


def save_checkpoint(path: Path, states: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    """Write states to an archive, atomically.

    Args:
        path: file to write; an existing one is replaced.
        states: name -> nested dicts, lists and tuples of tensors, numbers and strings.
        metadata: further data, as JSON types.

    Raises:
        OSError: the file cannot be written; an existing one is unchanged.
        TypeError: a state contains an object of another type.
    """
    entries = {_METADATA: as_json(dict(metadata))}
    for name, state in states.items():
        arrays: list[bytes] = []
        entries[f"{name}/tree.json"] = as_json(_packed(state, arrays))
        entries |= {f"{name}/{i}.npy": array for i, array in enumerate(arrays)}
    FORMAT.write(path, entries)


def load_checkpoint(path: Path, components: Mapping[str, Any]) -> dict[str, Any]:
    """Load states into components with `load_state_dict`, by name, and return the metadata.

    Raises:
        FileDamagedError: the file is truncated, altered, or of another kind. Components are
            unchanged, unless a state does not fit its component.
    """
    entries = FORMAT.read(path)
    try:
        metadata = json.loads(entries[_METADATA])
        if lacking := [name for name in components if f"{name}/tree.json" not in entries]:
            raise ValueError(f"it lacks the states of {lacking}")
        states = {
            name: _unpacked(json.loads(entries[f"{name}/tree.json"]), name, entries)
            for name in components
        }
        for name, component in components.items():
            component.load_state_dict(states[name])
    except Exception as error:  # a state that does not fit its component may raise anything
        raise FORMAT.damaged(path, error) from error
    return metadata


def _packed(value: Any, arrays: list[bytes]) -> Any:
    """Convert a state to JSON; its tensors are appended to `arrays`."""
    if isinstance(value, Tensor):
        arrays.append(npy(value.detach().cpu().numpy()))
        return {"tensor": len(arrays) - 1}
    if isinstance(value, Mapping):
        # keys may be numbers, but those of JSON objects cannot
        return {"dict": [[key, _packed(item, arrays)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_packed(item, arrays) for item in value]}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a state cannot contain a {type(value).__name__}")


def _unpacked(tree: Any, name: str, entries: Mapping[str, bytes]) -> Any:
    """Convert the JSON of `_packed` back to a state; its arrays are in `entries`."""
    if not isinstance(tree, dict):
        return tree
    ((kind, content),) = tree.items()
    if kind == "tensor":
        return torch.from_numpy(from_npy(entries[f"{name}/{content}.npy"]))
    if kind == "dict":
        return {key: _unpacked(item, name, entries) for key, item in content}
    return {"list": list, "tuple": tuple}[kind](_unpacked(item, name, entries) for item in content)
