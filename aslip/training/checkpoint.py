"""What a training resumes from, such that it goes on as if it had never stopped.

    components = {"actor": actor, "optimizer": optimizer, "collector": CollectorState(collector)}
    save_checkpoint(path, snapshot(components), {"step": 2048})
    metadata = load_checkpoint(path, components)

Guarantees:

- a collector's state, taken after a batch and loaded into another collector with such an
  environment and policy, leads to the same next batch, bit for bit;
- a checkpoint is there as a whole or not at all, and on the disk before `save_checkpoint` returns;
- it holds JSON and arrays, nothing that is run, and every byte is checked before any is loaded.

Trap: what a transform remembers must be in the tensordict, in its buffers, or in generators that
are its attributes or in dicts there. Anything else is not saved.
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

from aslip.envs import RobotEnv, SimulatedEnv, StackEnv
from aslip.errors import ConfigurationError
from aslip.files.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.sim.dynamics import longest_delay
from aslip.sim.parameters import DYNAMICS


class CollectorState:
    """All that the next batch of a collector depends on, apart from global generators.

    The tensordict that it goes on from, simulations and sensors, dynamics, generators and buffers
    of transforms, the policy, and the collector's own counters. To be used between batches.

    Args:
        collector: one that runs in this process, on an environment of `aslip.make_env`.
    """

    def __init__(self, collector: Collector) -> None:
        self._collector = collector

    def state_dict(self) -> dict[str, Any]:
        """The state; arrays of robots have them as their first dimension."""
        env = self._env
        return {
            # counters, the policy, and what transforms have registered
            "torchrl": self._collector.state_dict(),
            "carrier": _carrier(self._collector).to_dict(),
            "robots": _robots(env.base_env),
            "generators": {name: g.get_state() for name, g in _generators(env)},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        Raises:
            ConfigurationError: it is of another environment.
        """
        generators = dict(_generators(self._env))
        if generators.keys() != state["generators"].keys():
            odd = sorted(generators.keys() ^ state["generators"].keys())
            raise ConfigurationError(f"the state is of another stack, which differs in {odd}")
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
    """The tensordict that a collector will show to its policy next.

    TorchRL saves neither this nor simulations, and has no public way to it: its own `state_dict`
    lets resumed collectors begin new episodes. This and `_set_carrier` are all that we use of its
    inside.
    """
    return collector._carrier


def _set_carrier(collector: Collector, carrier: TensorDictBase, state: Mapping[str, Any]) -> None:
    collector._carrier = carrier
    if "traj_pool" in state:
        # loading the state has numbered new episodes
        collector._traj_pool.load_state_dict(state["traj_pool"])


def _robots(env: RobotEnv) -> dict[str, Any]:
    """States and dynamics of an environment's robots; nothing of robots that are no simulation."""
    if not isinstance(env, SimulatedEnv):
        return {}
    return {
        "states": torch.from_numpy(env.states()),
        "dynamics": {name: torch.from_numpy(values) for name, values in env.dynamics.items()},
        # [s] longer than any present delay, if a robot once had a longer one
        "memory": longest_delay(env.model),
        "divergences": env.divergences,
    }


def _set_robots(env: RobotEnv, robots: Mapping[str, Any]) -> None:
    """Write what `_robots` returned; robots that are no simulation stay where they are.

    Raises:
        ConfigurationError: it is of other robots.
    """
    if isinstance(env, SimulatedEnv) != bool(robots):
        raise ConfigurationError(
            "the state is of other robots: some are a simulation, some are not"
        )
    if not isinstance(env, SimulatedEnv):
        return
    if robots["memory"] > longest_delay(env.model):
        delay = min(robots["memory"], DYNAMICS["torque_delay"].high)
        env.set_dynamics({"torque_delay": delay})
    env.set_dynamics({name: values.numpy() for name, values in robots["dynamics"].items()})
    states, expected = robots["states"].numpy(), env.states().shape
    if states.shape != expected:
        raise ConfigurationError(f"states must have shape {expected}, got {states.shape}")
    env.set_states(states)
    env.divergences = robots["divergences"]


def _generators(env: StackEnv) -> Iterator[tuple[str, torch.Generator]]:
    """Every generator of the transforms, by the transform's name and where it is there."""

    def among(place: str, value: Any) -> Iterator[tuple[str, torch.Generator]]:
        if isinstance(value, torch.Generator):
            yield place, value
        elif isinstance(value, Mapping):
            for key, item in value.items():
                yield from among(f"{place}/{key}", item)

    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        yield from among(name, vars(transform))


# ----------------------------------------------------------------------- files


def snapshot(components: Mapping[str, Any]) -> dict[str, Any]:
    """Copies of the states of what has `state_dict`, by name."""
    return {name: deepcopy(component.state_dict()) for name, component in components.items()}


FORMAT = ArchiveFormat(
    "checkpoint",
    2,
    advice="a training is resumed by the version of aslip that began it",
)
"""Entries: `metadata.json`, and for each state its tree in JSON and its arrays."""


def save_checkpoint(path: Path, states: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    """Write states to an archive, as a whole or not at all.

    Args:
        path: the file.
        states: name -> nested dicts, lists and tuples of tensors, numbers and strings.
        metadata: of JSON types.

    Raises:
        OSError: it could not be written; a file that was there before is as it was.
        TypeError: a state holds something else.
    """
    entries = {_METADATA: as_json(dict(metadata))}
    for name, state in states.items():
        arrays: list[bytes] = []
        entries[_tree(name)] = as_json(_packed(state, arrays))
        entries |= {_array(name, i): array for i, array in enumerate(arrays)}
    FORMAT.write(path, entries)


def load_checkpoint(path: Path, components: Mapping[str, Any]) -> dict[str, Any]:
    """Load states into what has `load_state_dict`, by name; returns the metadata.

    Raises:
        FileDamagedError: the file is truncated, altered, or holds other things. Components are as
            they were, unless a state in it does not fit its component.
    """
    entries = FORMAT.read(path)
    try:
        metadata = json.loads(entries[_METADATA])
        states = {name: _state(name, entries) for name in components}
        for name, component in components.items():
            component.load_state_dict(states[name])
    except Exception as error:  # whatever a state makes of a component that it is not of
        raise FORMAT.damaged(path, error) from error
    return metadata


_METADATA = "metadata.json"


def _tree(name: str) -> str:
    return f"{name}/tree.json"


def _array(name: str, index: int) -> str:
    return f"{name}/{index}.npy"


def _state(name: str, entries: Mapping[str, bytes]) -> Any:
    """The state of a name."""
    if _tree(name) not in entries:
        raise ValueError(f"it is missing the state of {name!r}")
    return _unpacked(json.loads(entries[_tree(name)]), name, entries)


def _packed(value: Any, arrays: list[bytes]) -> Any:
    """A state as JSON, its tensors appended to `arrays`."""
    if isinstance(value, Tensor):
        arrays.append(npy(value.detach().cpu().numpy()))
        return {"tensor": len(arrays) - 1}
    if isinstance(value, Mapping):
        # keys may be numbers, which those of JSON objects cannot
        return {"dict": [[key, _packed(item, arrays)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_packed(item, arrays) for item in value]}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a state may not hold a {type(value).__name__}")


def _unpacked(tree: Any, name: str, entries: Mapping[str, bytes]) -> Any:
    """The state that `_packed` made JSON of, its arrays among entries."""
    if not isinstance(tree, dict):
        return tree
    ((kind, content),) = tree.items()
    if kind == "tensor":
        return torch.from_numpy(from_npy(entries[_array(name, content)]))
    if kind == "dict":
        return {key: _unpacked(item, name, entries) for key, item in content}
    return {"list": list, "tuple": tuple}[kind](_unpacked(item, name, entries) for item in content)
