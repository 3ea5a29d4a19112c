"""Actor, critic and their shared input normaliser; saving and loading (Sec. IV-B).

Both nets are 64-256-256-k with ReLU, on request made to treat left and right alike. The actor's
output is unbounded and its standard deviation fixed ("We choose to use fixed covariance ... the
output is unbounded"). The normaliser is part of the policy, so it travels with the weights.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import (
    AddStateIndependentNormalScale,
    InteractionType,
    TensorDictModule,
)
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.checkpoint import Checkpoint
from torchrl.modules import (
    MLP,
    IndependentNormal,
    ProbabilisticActor,
    ValueOperator,
)

from aslip.assets import asset_path
from aslip.errors import (
    AslipError,
    AssetError,
    ConfigurationError,
    FileDamagedError,
    UnknownNameError,
)
from aslip.symmetry import Mirror, Symmetrised, action_mirror, check_size, observation_mirror
from aslip.transforms import OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE

# normalised inputs further out than this are cut off: a fall must not shout down the rest
_CLIP = 10.0
_EPSILON = 1e-4
# inputs that vary less than this did not vary in training, and have trained no weights
_CONSTANT = 1e-8
# of the actor's last layer, so that training starts near the reference motion
_OUTPUT_SCALE = 0.01

POLICY_FILE = "policy.zip"
"""Name of the policy in the folder of a training run."""


@dataclass(frozen=True)
class PolicyShape:
    """What must be known to rebuild a policy before its weights are read."""

    observation_size: int = 64
    """Length of `observation` ("64D input space", Sec. IV-A)."""
    action_size: int = 10
    """Length of `action` ("10D vector", Sec. IV-A)."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers ("2 hidden layers of 256 nodes each", Sec. IV-B)."""
    std: float = math.exp(-2)
    """Standard deviation of every action [rad]; the paper gives no value, its public code this."""
    symmetric: bool = False
    """Whether the mirrored observation gets the mirrored action; not so in the paper."""


class RunningNormalizer(nn.Module):
    """Shift and scale to zero mean and unit variance, by statistics of everything it was shown.

    An input that was constant is shifted but not scaled: no weight behind it has been trained, so
    a small deviation must stay small.

    Args:
        size: length of the input.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    _offset: Tensor
    _scale: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("_offset", torch.zeros(size))
        self.register_buffer("_scale", torch.ones(size))

    @torch.no_grad()
    def update(self, values: Tensor) -> None:
        """Add (*b, size) values to the statistics, by the parallel variance formula."""
        values = values.reshape(-1, self.mean.numel()).double()
        count = values.shape[0]
        variance, mean = torch.var_mean(values, dim=0, correction=0)
        total = self.count + count
        delta = mean - self.mean
        moment = self.variance * self.count + variance * count
        moment += delta.square() * self.count * count / total
        self.mean += delta * count / total
        self.variance.copy_(moment / total)
        self.count.copy_(total)
        self._refresh()

    def _refresh(self) -> None:
        """Derive offset and scale from the statistics."""
        self._offset.copy_(self.mean)
        scale = (self.variance + _EPSILON**2).rsqrt()
        self._scale.copy_(torch.where(self.variance < _CONSTANT, 1.0, scale))

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Load the statistics; what follows from them may have been derived in another way."""
        super()._load_from_state_dict(*args, **kwargs)
        self._refresh()

    def forward(self, values: Tensor) -> Tensor:
        """Normalised (*b, size) values.

        Raises:
            ShapeError: there is another number of values.
        """
        check_size(values, len(self._offset))
        return ((values - self._offset) * self._scale).clamp(-_CLIP, _CLIP)


def make_actor(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
) -> ProbabilisticActor:
    """The policy: `observation` -> `action`, with `action_log_prob`.

    Deterministic unless an exploration type asks for samples, as a collector does.

    Args:
        normalizer: shared with the critic.
        shape: sizes, standard deviation, symmetry.
        observation: keys of the observation's entries, of which a symmetric policy knows mirror
            images.

    Raises:
        ConfigurationError: a symmetric policy would observe more or less than these entries.
        UnknownNameError: it does not know how the mirror image of an entry looks.
    """
    shape = shape or PolicyShape()
    net = MLP(
        in_features=shape.observation_size,
        out_features=shape.action_size,
        num_cells=list(shape.hidden),
        activation_class=nn.ReLU,
    )
    output = net[-1]
    assert isinstance(output, nn.Linear)
    with torch.no_grad():
        output.weight.mul_(_OUTPUT_SCALE)
        output.bias.zero_()
    scale = AddStateIndependentNormalScale(
        shape.action_size,
        scale_mapping="exp",
        make_param=False,
        init_value=math.log(shape.std),
    )
    layers: list[nn.Module] = [normalizer, net]
    if shape.symmetric:
        mirrors = _mirror_of(shape, observation), action_mirror()
        layers = [Symmetrised(nn.Sequential(*layers), *mirrors)]
    return ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(*layers, scale),
            in_keys=["observation"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
        default_interaction_type=InteractionType.DETERMINISTIC,
    )


def set_std(actor: nn.Module, std: float) -> None:
    """Change the standard deviation of all actions of an actor of `make_actor` [rad]."""
    scale = next(m for m in actor.modules() if isinstance(m, AddStateIndependentNormalScale))
    with torch.no_grad():
        scale.state_independent_scale.fill_(math.log(std))


def make_critic(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
    *,
    scale: float = 1.0,
) -> ValueOperator:
    """The value function: `observation` -> `state_value`.

    Args:
        normalizer: shared with the actor.
        shape: as the actor's.
        observation: as the actor's.
        scale: what an output of one is worth. Near the size of returns, the net learns them sooner.
    """
    shape = shape or PolicyShape()
    net = MLP(
        in_features=shape.observation_size,
        out_features=1,
        num_cells=list(shape.hidden),
        activation_class=nn.ReLU,
    )
    value: nn.Module = nn.Sequential(normalizer, net, _Scale(scale))
    if shape.symmetric:
        value = Symmetrised(value, _mirror_of(shape, observation))
    return ValueOperator(value, in_keys=["observation"])


def _mirror_of(shape: PolicyShape, observation: Sequence[NestedKey]) -> Mirror:
    mirror = observation_mirror(observation)
    if len(mirror.index) != shape.observation_size:
        raise ConfigurationError(
            f"the observation has {shape.observation_size} numbers, and the entries whose mirror"
            f" images are known have {len(mirror.index)}; a policy that is not symmetric"
            " (--no-symmetric) needs none"
        )
    return mirror


class _Scale(nn.Module):
    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, values: Tensor) -> Tensor:
        return self.factor * values


def save_policy(
    path: str | Path,
    actor: nn.Module,
    shape: PolicyShape,
    made_by: Mapping[str, Any] | None = None,
    *,
    stack: str | None = "aslip",
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
) -> None:
    """Write a policy that `load_policy` reads: a ZIP archive of plain arrays, nothing pickled.

    Args:
        path: the file; replaced as a whole.
        actor: from `make_actor`.
        shape: what it was made with.
        made_by: settings and versions of what made it, of JSON types.
        stack: name of the stack that it acts on, one of `aslip.stack.STACKS`; None for another.
        observation: keys of the entries that its observation is made of.
    """
    card = {
        "shape": asdict(shape),
        "stack": stack,
        "observation": entry_names(observation),
        "made_by": dict(made_by or {}),
    }
    Checkpoint(actor=actor).save(path, format="archive", metadata=card)


def load_policy(name_or_path: str | Path) -> ProbabilisticActor:
    """A trained policy: maps the environment's tensordict to `action`, deterministic by default.

    Its parameters require no gradients; to train it further, let them.

    Args:
        name_or_path: name of a shipped policy, file of a policy, or folder of a training run.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
        ConfigurationError: the stack it was trained on, one of `aslip.stack.STACKS`, gives another
            observation in this version of the package.
    """
    path = find_policy(name_or_path)
    card = _card(path)
    try:
        shape = PolicyShape(**{**card["shape"], "hidden": tuple(card["shape"]["hidden"])})
        names = [str(name) for name in card["observation"]]
    except (KeyError, TypeError) as error:
        raise FileDamagedError(f"{str(path)!r} is no policy: its card lacks {error}") from error
    known = [entry_names(table) for table in (OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE)]
    if card.get("stack", "paper") is not None and names not in known:
        raise ConfigurationError(
            f"the policy {str(path)!r} expects the observation {names}; this version of aslip"
            f" gives {' or '.join(map(str, known))}"
        )
    table = [unravel_key(tuple(name.split("/"))) for name in names]
    try:
        actor = make_actor(RunningNormalizer(shape.observation_size), shape, table)
    except AslipError:
        raise
    except Exception as error:  # whatever a wrong size makes of a network
        raise _damaged(path, error) from error
    load_components(path, actor=actor)
    # nothing differentiates through a simulator: without this, rollouts would carry graphs along
    return actor.eval().requires_grad_(False)


def policy_stack(name_or_path: str | Path) -> str:
    """Name of the stack that a policy acts on, one of `aslip.stack.STACKS`.

    Policies of before there were several act on the paper's.

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
        ConfigurationError: it acts on a stack of its own.
    """
    stack = _card(find_policy(name_or_path)).get("stack", "paper")
    if stack is None:
        raise ConfigurationError(
            f"the policy {str(name_or_path)!r} was trained with a stack of its own, which has no"
            " name: make an environment with the same edits, and give it that"
        )
    return stack


def policy_observation(name_or_path: str | Path) -> list[str]:
    """Entries of the observation that a policy was trained on, such as "estimate/height".

    Raises:
        AssetError: there is no such policy.
        FileDamagedError: it is truncated, altered, or no policy.
    """
    path = find_policy(name_or_path)
    try:
        return list(_card(path)["observation"])
    except (KeyError, TypeError) as error:
        raise FileDamagedError(f"{str(path)!r} is no policy: its card lacks {error}") from error


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


def read_manifest(path: Path) -> dict[str, Any]:
    """Contents and metadata of a policy.

    Raises:
        FileDamagedError: the file is truncated, altered, or of another kind.
    """
    try:
        return Checkpoint.manifest(path)
    except Exception as error:  # one cause, a bad file, has many exceptions
        raise _damaged(path, error) from error


def _card(path: Path) -> dict[str, Any]:
    """What a policy says of itself; see `save_policy`."""
    card = read_manifest(path).get("metadata", {})
    if not isinstance(card, dict):
        raise FileDamagedError(f"{str(path)!r} is no policy: its card is {card!r}")
    return card


def load_components(path: Path, **components: Any) -> None:
    """Restore named objects from a policy.

    Raises:
        FileDamagedError: the file is truncated, altered, or holds other things.
    """
    try:
        _refuse_programs(path)
        Checkpoint(**components).load(path)
    except Exception as error:
        raise _damaged(path, error) from error


def _refuse_programs(path: Path) -> None:
    """Check that an archive holds JSON and arrays only: TorchRL and TensorDict unpickle the rest.

    Raises:
        ValueError: it holds something else.
    """
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if not name.endswith((".json", ".memmap")):
                raise ValueError(f"it holds {name!r}, which is neither JSON nor an array")
            if name.endswith("/meta.json"):
                kind = json.loads(archive.read(name))["_type"]
                if kind != str(TensorDict):
                    raise ValueError(f"{name!r} describes a {kind}, not tensors")


def _damaged(path: Path, error: Exception) -> FileDamagedError:
    return FileDamagedError(f"{str(path)!r} is no intact policy ({type(error).__name__}: {error})")


def entry_names(table: Iterable[NestedKey]) -> list[str]:
    """Keys of an observation's entries as in a policy's card, such as "estimate/height"."""
    keys = [unravel_key(key) for key in table]
    return [key if isinstance(key, str) else "/".join(map(str, key)) for key in keys]
