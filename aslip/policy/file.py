"""A policy's file: what it holds, what is checked when it is written and when it is read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from aslip.errors import AssetError, ConfigurationError, UnknownNameError
from aslip.files.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.files.assets import asset_path
from aslip.policy.networks import PolicyShape, RunningNormalizer, entry_names, make_actor
from aslip.transforms import OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE

POLICY_FILE = "policy.zip"
"""Name of the policy in the folder of a training run."""

POLICY_FORMAT = ArchiveFormat(
    "policy", 2, advice="recipes/convert_policy.py rewrites intact policies of earlier versions"
)
"""Entries: `card.json`, and `weights/NAME.npy` for each parameter and buffer."""

CARD = "card.json"
"""Entry of a policy's file that says what it is; see `save_policy`."""
_WEIGHTS = "weights/"


def save_policy(
    path: str | Path,
    actor: nn.Module,
    shape: PolicyShape,
    made_by: Mapping[str, Any] | None = None,
    *,
    stack: str | None = "aslip",
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
    baseline: NestedKey | None = ("reference", "motor_target"),
) -> None:
    """Write a policy that `load_policy` reads: an archive of plain arrays, nothing pickled.

    What `aslip.envs.policy_interface(env)` returns goes into the last three arguments.

    Args:
        path: the file; replaced as a whole.
        actor: from `make_actor`.
        shape: what it was made with.
        made_by: settings and versions of what made it, of JSON types.
        stack: name of the stack that it acts on, one of `aslip.envs.STACKS`; None for another.
        observation: keys of the entries that its observation is made of, in order.
        baseline: key of the angles that its action is added to; None for an action of another kind.

    Raises:
        ConfigurationError: the actor is not what `make_actor` makes of shape and observation, or
            has weights that are not finite. Nothing is written.
        OSError: the file cannot be written; one that was there is as it was.
    """
    if odd := _unlike(actor, shape, observation):
        raise ConfigurationError(
            f"the actor cannot be saved as a policy of {shape}: {'; '.join(odd[:4])}; only actors"
            " of make_actor(normalizer, shape, observation) can"
        )
    card = {
        "shape": asdict(shape),
        "stack": stack,
        "observation": entry_names(observation),
        "baseline": None if baseline is None else entry_names([baseline])[0],
        "made_by": dict(made_by or {}),
    }
    weights = {
        f"{_WEIGHTS}{name}.npy": npy(value.detach().cpu().numpy())
        for name, value in actor.state_dict().items()
    }
    POLICY_FORMAT.write(Path(path), {CARD: as_json(card), **weights})


def _unlike(actor: nn.Module, shape: PolicyShape, observation: Sequence[NestedKey]) -> list[str]:
    """Why an actor is not the one that `load_policy` would make, a clause each."""
    with torch.random.fork_rng(devices=[]):
        loaded = make_actor(RunningNormalizer(shape.observation_size), shape, observation)
    weights = {name: value.detach().cpu() for name, value in actor.state_dict().items()}
    if odd := _differences(loaded, weights):
        return odd
    loaded.load_state_dict(weights)
    device = next(iter(actor.state_dict().values())).device
    for probe in torch.linspace(-1, 1, 2 * shape.observation_size).view(2, 1, -1):
        given = TensorDict(observation=probe, batch_size=1)
        ours, theirs = loaded(given.clone()), actor(given.to(device)).cpu()
        if not torch.allclose(ours["loc"], theirs["loc"], rtol=1e-4, atol=1e-5):
            return ["its actions are not those of such a network with the same weights"]
    return []


def _differences(expected: nn.Module, weights: Mapping[str, Tensor]) -> list[str]:
    """Why weights are not those of a module such as `expected`, a clause each."""
    wanted = expected.state_dict()
    odd = [f"it lacks {name!r}" for name in wanted.keys() - weights.keys()]
    odd += [f"it has {name!r}" for name in weights.keys() - wanted.keys()]
    for name in sorted(wanted.keys() & weights.keys()):
        is_, should_be = _kind(weights[name]), _kind(wanted[name])
        if is_ != should_be:
            odd.append(f"{name!r} is {is_} instead of {should_be}")
        elif not weights[name].isfinite().all():
            odd.append(f"{name!r} is not finite")
    return sorted(odd)


def _kind(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} of shape {tuple(tensor.shape)}"


def load_policy(name_or_path: str | Path) -> ProbabilisticActor:
    """A trained policy: maps the environment's tensordict to `action`, deterministic by default.

    Its parameters require no gradients; to train it further, let them.

    Args:
        name_or_path: name of a shipped policy, file of a policy, or folder of a training run.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
        ConfigurationError: the stack it was trained on, one of `aslip.envs.STACKS`, gives another
            observation in this version of the package.
    """
    path = find_policy(name_or_path)
    entries = POLICY_FORMAT.read(path)
    card = _card(path, entries)
    shape, names = card["shape"], card["observation"]
    if card["stack"] is not None and names not in _known_observations():
        raise ConfigurationError(
            f"the policy {str(path)!r} has another observation than this version of aslip gives:"
            f" {observation_difference(names, _known_observations()[0])}"
        )
    table = [unravel_key(tuple(name.split("/"))) for name in names]
    try:
        weights = _weights(entries, shape)
        actor = make_actor(RunningNormalizer(shape.observation_size), shape, table)
        if odd := _differences(actor, weights):
            raise ValueError("; ".join(odd))
    except Exception as error:  # whatever a stranger's card and arrays are
        raise POLICY_FORMAT.damaged(path, error) from error
    actor.load_state_dict(weights)
    # nothing differentiates through a simulator: without this, rollouts would carry graphs along
    return actor.eval().requires_grad_(False)


def _weights(entries: Mapping[str, bytes], shape: PolicyShape) -> dict[str, Tensor]:
    """Weights by name, of a file of as many as its shape asks for.

    Raises:
        ValueError: there are fewer, and nothing is allocated for the network that would need them.
    """
    arrays = {
        name.removeprefix(_WEIGHTS).removesuffix(".npy"): torch.from_numpy(from_npy(data))
        for name, data in entries.items()
        if name.startswith(_WEIGHTS)
    }
    numbers = sum(array.numel() for array in arrays.values())
    if numbers < shape.parameters or len(arrays) < 2 * len(shape.hidden):
        raise ValueError(
            f"its card describes a network of {shape.parameters} numbers in {len(shape.hidden)}"
            f" hidden layers, and it has {numbers} numbers in {len(arrays)} arrays"
        )
    return arrays


def policy_stack(name_or_path: str | Path) -> str:
    """Name of the stack that a policy acts on, one of `aslip.envs.STACKS`.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
        ConfigurationError: it acts on a stack of its own; the message says what is different.
    """
    card = read_card(name_or_path)
    if card["stack"] is None:
        raise ConfigurationError(
            f"the policy {str(name_or_path)!r} was trained with a stack of its own, which has no"
            f" name: {_own(card)}; make an environment with the same edits, and give it that"
        )
    return card["stack"]


def _own(card: Mapping[str, Any]) -> str:
    """Difference between a policy's stack and the named ones, in words."""
    if card["observation"] not in _known_observations():
        return observation_difference(card["observation"], _known_observations()[0])
    if card["baseline"] is None:
        return "its action is not, or not only, an `ActionDelta`"
    return (
        f"its action is added to {card['baseline']!r}, and that or the reference's motion is none"
        " of a stack that has a name"
    )


def observation_difference(has: Sequence[str], expected: Sequence[str]) -> str:
    """Difference between the entries of two observations, in words."""
    lacks = [name for name in expected if name not in has]
    more = [name for name in has if name not in expected]
    parts = [f"its observation lacks {lacks}"] if lacks else []
    parts += [f"its observation has {more} besides"] if more else []
    return " and ".join(parts) or f"its observation has another order, {list(has)}"


def _known_observations() -> list[list[str]]:
    return [entry_names(table) for table in (OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE)]


def find_policy(name_or_path: str | Path) -> Path:
    """The file of a policy: given, inside the folder of a run, or shipped.

    Raises:
        AssetError: there is no such policy.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    if (path / POLICY_FILE).is_file():
        return path / POLICY_FILE
    try:
        return asset_path(f"policies/{name_or_path}.zip")
    except AssetError:
        folder = asset_path("policies/aslip.zip").parent
        shipped = sorted(policy.stem for policy in folder.glob("*.zip"))
        hint = UnknownNameError.among("shipped policy", str(name_or_path), shipped)
        raise AssetError(
            f"no policy {str(name_or_path)!r}: it is neither a file, nor the folder of a run with"
            f" a {POLICY_FILE}, and there is {hint}"
        ) from None


def read_card(name_or_path: str | Path) -> dict[str, Any]:
    """Card of a policy: how it is built and what it acts on.

    Returns:
        What was given to `save_policy`: `shape`, `made_by`, `stack`, and with names as text
        `observation` and `baseline`.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
    """
    path = find_policy(name_or_path)
    return _card(path, POLICY_FORMAT.read(path))


def _card(path: Path, entries: Mapping[str, bytes]) -> dict[str, Any]:
    """The card among entries, every item of its type.

    Raises:
        FileDamagedError: an item is missing, or of another type.
    """
    try:
        card = json.loads(entries[CARD])
        shape, texts = card["shape"], (card["stack"], card["baseline"])
        typed = all(isinstance(text, str | None) for text in texts)
        if not typed or not isinstance(card["made_by"], dict):
            raise ValueError("its card has items of wrong types")
        return {
            **card,
            "shape": PolicyShape(**{**shape, "hidden": tuple(shape["hidden"])}),
            "observation": [str(name) for name in card["observation"]],
        }
    except Exception as error:  # whatever a stranger's card is made of
        raise POLICY_FORMAT.damaged(path, error) from error
