"""Policy files: writing and reading, with checks.

A file has a card (`card.json`) and the weights as plain arrays. The card names the function that
makes the network, but reading a file never imports code: "mlp", "planned" and "gru" are built in,
and any other network needs the `network` argument of `load_policy`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor

from aslip.base.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.base.assets import asset_path, user_path
from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.errors import AssetError, ConfigurationError, UnknownNameError
from aslip.policy.hub import HUB, hub_file
from aslip.policy.networks import (
    PolicyShape,
    RunningNormalizer,
    entry_names,
    make_actor,
    make_planned_actor,
)
from aslip.policy.recurrent import make_recurrent_actor, require_memory
from aslip.transforms import DIRECTION_TABLE, OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE
from aslip.transforms.command import checked_rates
from aslip.transforms.observation import PLANNED_TABLE

MakeActor = Callable[[RunningNormalizer, PolicyShape, Sequence[NestedKey]], ProbabilisticActor]
"""Function from normaliser, shape and observation keys to an actor."""

POLICY_FILE = "policy.zip"
"""Name of the policy in the folder of a training run."""


POLICY_FORMAT = ArchiveFormat(
    "policy", 2, instead=f"the policy of a run is the file {POLICY_FILE} in its folder"
)
"""Entries: `card.json`, and `weights/NAME.npy` for each parameter and buffer."""

CARD = "card.json"
"""Entry of a policy file that describes the policy; see `save_policy`."""
_WEIGHTS = "weights/"
_LONGEST_REASON = 300
# observations and action baselines of the named stacks
_TABLES = (
    OBSERVATION_TABLE,
    SINGLE_REFERENCE_TABLE,
    DIRECTION_TABLE,
    PLANNED_TABLE,
)

_NETWORKS: Mapping[str, MakeActor] = {
    "mlp": make_actor,
    "planned": make_planned_actor,
    "gru": make_recurrent_actor,
}


@on_cpu_in_single
def save_policy(
    path: str | Path,
    actor: nn.Module,
    shape: PolicyShape,
    made_by: Mapping[str, Any] | None = None,
    *,
    network: MakeActor = make_actor,
    stack: str | None = "straight",
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
    baseline: NestedKey | None = ("reference", "motor_target"),
    command_rates: Sequence[float] | None = None,
    stands: bool = False,
    library_sha256: str | None = None,
) -> None:
    """Write a policy for `load_policy`: an archive of plain arrays and JSON.

    `aslip.policy.policy_interface(env)` gives the last six arguments.

    Args:
        path: path of the file; an existing one is replaced atomically.
        actor: the policy.
        shape: its shape.
        made_by: settings and versions of the training, as JSON types.
        network: function that made the actor.
        stack: name of its stack, one of `aslip.envs.STACKS`; None for a stack of your own.
        observation: keys of the observation's entries, in order.
        baseline: key of the angles to which the action is added; None for another kind of action.
        command_rates: largest rates of the filtered command that the policy follows [m/s^2,
            rad/s^2], see `aslip.transforms.CommandFilter`; None if it follows the command.
        stands: True if its robots can stand, see `aslip.transforms.StandClock`.
        library_sha256: `GaitLibrary.sha256` of the gaits that it follows; None if they do not
            matter.

    Raises:
        ConfigurationError: `network` makes an actor that differs from `actor`, a weight is not
            finite, or no named stack has this observation. Nothing is written.
        OSError: the file cannot be written; an existing one stays intact.
    """
    try:
        _check_loadable(actor, network, shape, observation)
    except (RuntimeError, ValueError) as error:
        raise ConfigurationError(
            f"the actor differs from the one that {_network_name(network)!r} makes from {shape}:"
            f" {error}; give the function that made it, network=..."
        ) from error
    if stack is not None and entry_names(observation) not in _known_observations():
        raise ConfigurationError(
            f"no stack named {stack!r} gives this observation:"
            f" {_nearest_difference(entry_names(observation))}; give stack=None"
        )
    card = {
        "network": _network_name(network),
        "shape": asdict(shape),
        "stack": stack,
        "observation": entry_names(observation),
        "baseline": None if baseline is None else entry_names([baseline])[0],
        "command_rates": None if command_rates is None else [*command_rates],
        "stands": stands,
        "library_sha256": library_sha256,
        "made_by": dict(made_by or {}),
    }
    weights = {
        f"{_WEIGHTS}{name}.npy": npy(value.detach().cpu().numpy())
        for name, value in actor.state_dict().items()
    }
    POLICY_FORMAT.write(user_path(path), {CARD: as_json(card), **weights})


def _network_name(network: MakeActor) -> str:
    """Name of a function that makes actors: "mlp", "planned", "gru", or where it is defined."""
    for name, known in _NETWORKS.items():
        if network is known:
            return name
    name = getattr(network, "__qualname__", type(network).__qualname__)
    return f"{network.__module__}.{name}"


def _check_loadable(
    actor: nn.Module, network: MakeActor, shape: PolicyShape, observation: Sequence[NestedKey]
) -> None:
    """Check that `load_policy` would make the same actor.

    Raises:
        ValueError, RuntimeError: names, shapes or types of weights differ, one is not finite, or
            the actions differ.
    """
    with torch.random.fork_rng(devices=[]):
        loaded = network(RunningNormalizer(shape.observation_size), shape, observation)
    _fill(loaded, {name: value.detach().cpu() for name, value in actor.state_dict().items()})
    probe = torch.linspace(-1, 1, 2 * shape.observation_size).view(2, -1)
    probe = torch.cat([probe, torch.zeros_like(probe[:1])])  # a robot that follows no plan
    given = TensorDict(observation=probe, is_init=torch.ones(3, 1).bool(), batch_size=3)
    device = next(iter(actor.state_dict().values())).device
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        ours, theirs = actor(given.to(device)).cpu(), loaded(given.clone())
    if not torch.allclose(ours["action"], theirs["action"], rtol=1e-4, atol=1e-5):
        raise ValueError("its actions differ for the same weights")


def _fill(actor: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Load weights into an actor.

    Raises:
        ValueError: a weight is not finite, or names or shapes differ from those of the actor.
    """
    for name, value in weights.items():
        if not value.isfinite().all():
            raise ValueError(f"{name!r} is not finite")
    try:
        actor.load_state_dict(weights)
    except RuntimeError as error:  # its message has a line for each difference
        raise ValueError(" ".join(str(error).split())[:_LONGEST_REASON]) from error


@check_types
@on_cpu_in_single
def load_policy(name_or_path: str | Path, network: MakeActor | None = None) -> ProbabilisticActor:
    """Load a trained policy: the environment's tensordict -> `action`, deterministic by default.

    Parameters have `requires_grad=False`; set it to True to train further. Prepare the environment
    of a recurrent policy with `aslip.policy.add_memory`; without it, the second policy step raises
    ConfigurationError.

    Args:
        name_or_path: name of a shipped policy, file of a policy, folder of a training run, or
            "hf://owner/name", which is downloaded from the Hugging Face hub (extra `hub`).
        network: function that makes the actor, for a network of your own.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: the file is truncated, altered, or not a policy.
        ConfigurationError: the file has a custom network, and `network` is not given; or this
            version of the package has another observation for the policy's named stack.
    """
    path = find_policy(name_or_path)
    entries = POLICY_FORMAT.read(path)
    card = _card(path, entries)
    shape, names = card["shape"], card["observation"]
    if card["stack"] is not None and names not in _known_observations():
        raise ConfigurationError(
            f"the policy {str(path)!r} has another observation than this version of aslip gives:"
            f" {_nearest_difference(names)}"
        )
    if network is None and card["network"] not in _NETWORKS:
        raise ConfigurationError(
            f"the network of the policy {str(path)!r} is made by {card['network']!r}, which is not"
            " imported from a file: load_policy(path, network=...) with that function, if you"
            " trust it"
        )
    table = [unravel_key(tuple(name.split("/"))) for name in names]

    def make(function: MakeActor) -> ProbabilisticActor:
        return function(RunningNormalizer(shape.observation_size), shape, table)

    # outside the try block: a mistake in the caller's function is not a damaged file
    actor = None if network is None else require_memory(make(network))
    try:
        weights = _weights(entries)
        if actor is None:
            _check_count(weights, shape)
            actor = make(_NETWORKS[card["network"]])
        _fill(actor, weights)
    except Exception as error:  # an untrusted card may fail in many ways
        raise POLICY_FORMAT.damaged(path, error) from error
    # for messages about environments that the policy does not fit
    cast("Any", actor).card = {**card, "name": str(name_or_path)}
    # otherwise rollouts would keep autograd graphs
    return actor.eval().requires_grad_(False)


def _weights(entries: Mapping[str, bytes]) -> dict[str, Tensor]:
    """Weights by name."""
    return {
        name.removeprefix(_WEIGHTS).removesuffix(".npy"): torch.from_numpy(from_npy(data))
        for name, data in entries.items()
        if name.startswith(_WEIGHTS)
    }


def _check_count(weights: Mapping[str, Tensor], shape: PolicyShape) -> None:
    """Check that there are enough weights for a shape before memory is allocated for it.

    Raises:
        ValueError: there are fewer.
    """
    numbers = sum(array.numel() for array in weights.values())
    if numbers < shape.parameters or len(weights) < 2 * len(shape.hidden):
        raise ValueError(
            f"its card describes a network of {shape.parameters} numbers in {len(shape.hidden)}"
            f" hidden layers, and it has {numbers} numbers in {len(weights)} arrays"
        )


def policy_stack(name_or_path: str | Path) -> str:
    """Name of the stack of a policy, one of `aslip.envs.STACKS`.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: the file is truncated, altered, or not a policy.
        ConfigurationError: the policy's stack has no name; the message says how it differs.
    """
    card = read_card(name_or_path)
    if card["stack"] is None:
        why = f"its action is added to {card['baseline']!r}, or its reference is no gait library"
        if card["observation"] not in _known_observations():
            why = _nearest_difference(card["observation"])
        raise ConfigurationError(
            f"the policy {str(name_or_path)!r} was trained with an unnamed stack: {why}; give an"
            " environment with the same edits"
        )
    return card["stack"]


def observation_difference(has: Sequence[str], expected: Sequence[str]) -> str:
    """Difference between the entries of two observations, in words."""
    lacks = [name for name in expected if name not in has]
    more = [name for name in has if name not in expected]
    parts = [f"its observation lacks {lacks}"] if lacks else []
    parts += [f"its observation also has {more}"] if more else []
    return " and ".join(parts) or f"its observation has another order, {list(has)}"


def _nearest_difference(has: Sequence[str]) -> str:
    """Difference between an observation and the most similar one of the named stacks, in words."""
    nearest = min(_known_observations(), key=lambda known: len({*known} ^ {*has}))
    return observation_difference(has, nearest)


def _known_observations() -> list[list[str]]:
    return [entry_names(table) for table in _TABLES]


def find_policy(name_or_path: str | Path) -> Path:
    """Path of a policy file: of a path, a run folder, a shipped policy's name or the hub.

    Raises:
        AssetError: there is no such policy.
    """
    if str(name_or_path).startswith(HUB):
        return hub_file(str(name_or_path), POLICY_FILE)
    path = user_path(name_or_path)
    if path.is_file():
        return path
    if (path / POLICY_FILE).is_file():
        return path / POLICY_FILE
    try:
        return asset_path(f"policies/{name_or_path}.zip")
    except AssetError:
        folder = asset_path("policies/straight.zip").parent
        shipped = sorted(policy.stem for policy in folder.glob("*.zip"))
        hint = UnknownNameError.among("shipped policy", str(name_or_path), shipped)
        raise AssetError(
            f"no policy {str(name_or_path)!r}: it is neither a file, nor the folder of a run with"
            f" a {POLICY_FILE}, and there is {hint}"
        ) from None


def read_card(name_or_path: str | Path) -> dict[str, Any]:
    """Card of a policy: network, interface and provenance.

    Returns:
        The arguments of `save_policy`, but `network`, `observation` and `baseline` as text.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: the file is truncated, altered, or not a policy.
    """
    path = find_policy(name_or_path)
    return _card(path, POLICY_FORMAT.read(path))


def _card(path: Path, entries: Mapping[str, bytes]) -> dict[str, Any]:
    """Card of the archive's entries, with the types of its items checked.

    Raises:
        FileDamagedError: an item is missing, or of another type.
    """
    try:
        card = json.loads(entries[CARD])
        shape, rates = card["shape"], card["command_rates"]
        texts = card["stack"], card["baseline"], card["library_sha256"]
        typed = all(isinstance(text, str | None) for text in texts)
        typed = typed and isinstance(card["network"], str) and isinstance(card["made_by"], dict)
        typed = typed and isinstance(card["stands"], bool)
        if not typed:
            raise ValueError("its card has items of wrong types")
        return {
            **card,
            "shape": PolicyShape(**{**shape, "hidden": tuple(shape["hidden"])}),
            "observation": [str(name) for name in card["observation"]],
            "command_rates": None if rates is None else checked_rates(rates),
        }
    except Exception as error:  # an untrusted card may fail in many ways
        raise POLICY_FORMAT.damaged(path, error) from error
