"""Kinds of files: writing, reading and comparison.

To add a kind, add a `Kind` to `KINDS`.
"""

import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

import aslip
from aslip.envs import default_stack
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.library import GaitLibrary
from aslip.library.table import ARRAYS
from aslip.log import Recorder, read, recover, replay
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, read_card, save_policy
from aslip.rom import SampledMotion
from aslip.training.checkpoint import load_checkpoint, save_checkpoint
from tests.helpers import identical
from tests.training.trainings import Holder


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str
    """Name in tables."""
    suffix: str
    """Extension of the file's name, with the dot."""
    write: Callable[[Path], None]
    """Write an intact file with fixed content, replacing an existing one."""
    load: Callable[[Path], Any]
    """Content of a file; raises an `AslipError` if the file is damaged."""
    identical: Callable[[Any, Any], bool] = identical
    """Comparison of two contents, bit for bit."""
    archive: bool = True
    """Whether files of the kind are ZIP archives."""
    makes_folders: bool = False
    """Whether `write` creates a missing folder."""


def _require_finite(content: Any) -> Any:
    """Return the content if all its tensors are finite.

    Raises:
        ArithmeticError: a tensor is not finite.
    """
    if isinstance(content, torch.Tensor) and not content.isfinite().all():
        raise ArithmeticError("loaded numbers are not finite")
    if isinstance(content, Mapping):
        content = dict(content)
        for item in content.values():
            _require_finite(item)
    if isinstance(content, list | tuple):
        for item in content:
            _require_finite(item)
    return content


def _write_policy(path: Path) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        shape = PolicyShape(symmetric=True)
        normalizer = RunningNormalizer(64)
        normalizer.update(torch.randn(100, 64))
        save_policy(path, make_actor(normalizer, shape), shape, {"seed": 0})


def _load_policy(path: Path) -> Any:
    actor = aslip.load_policy(path)
    observation = torch.linspace(-1, 1, 64).expand(2, -1)
    action = actor(TensorDict(observation=observation, batch_size=2))["action"]
    return {"card": read_card(path), "weights": _require_finite(actor.state_dict()), "act": action}


def _write_library(path: Path) -> None:
    library = GaitLibrary.load()
    rows = {name: getattr(library.table, name)[[5, 10]] for name in ARRAYS}
    thinned = {name: v[:, ::16] if v.ndim > 1 else v for name, v in rows.items()}
    table = replace(library.table, axes=(library.speeds[[5, 10]],), **thinned)
    walk = SampledMotion.from_motion(library.motions[10], 8)
    GaitLibrary([library.motions[5], walk], table, made_by={"command": "none"}).save(path)


def _load_library(path: Path) -> Any:
    library = GaitLibrary.load(path)
    point = torch.full((1, 1), 0.7)
    stored: Any = library.motions
    arrays = [motion.to_arrays() for motion in stored]
    return _require_finite(
        {
            "table": [_tensor(getattr(library.table, name)) for name in ARRAYS],
            "axes": [_tensor(axis) for axis in library.table.axes],
            "torque_jumps": library.table.torque_jumps,
            "motions": [{k: _comparable(v) for k, v in motion.items()} for motion in arrays],
            "reference": library.lookup(point, point).motor_position,
            "start": library.initial_state(point, point),
            "made_by": library.made_by,
        }
    )


def _comparable(array: np.ndarray) -> Any:
    """Tensor of an array, or its text."""
    return str(array) if array.dtype.kind == "U" else _tensor(array)


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(array.copy())


def _write_checkpoint(path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(64, 64, generator=generator)
    states = {
        "actor": {"weights": weights, "count": torch.tensor(3.0, dtype=torch.float64)},
        "optimizer": {"state": {0: {"step": 5, "moments": weights[0]}}, "groups": [{"lr": 1e-3}]},
        "rng": {"torch_cpu": generator.get_state(), "numpy": ("MT19937", 1, None)},
    }
    save_checkpoint(path, states, {"step": 64, "episodes": [0.5, 1.5]})


def _load_checkpoint(path: Path) -> Any:
    holders = {name: Holder() for name in ("actor", "optimizer", "rng")}
    metadata = load_checkpoint(path, holders)
    return {"metadata": metadata, **{name: holder.state for name, holder in holders.items()}}


def _write_log(path: Path) -> None:
    """Log one fall, replacing an existing file.

    Raises:
        OSError: the file cannot be written, and the partial file is deleted. (The recorder itself
            only warns.)
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            _log_fall(path)
    except (ConfigurationError, RuntimeWarning) as error:
        path.with_name(path.name + ".part").unlink(missing_ok=True)
        raise OSError(str(error)) from error


def _log_fall(path: Path) -> None:
    library = GaitLibrary.load()
    stack = {**default_stack(library), "recorder": Recorder(path, overwrite=True)}
    env = aslip.make_env(stack=stack, num_threads=1, seed=0)
    td = env.reset()
    for _ in range(36):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(1, 10)))
    env.close()


def _load_log(path: Path) -> Any:
    """Content of a log, except for the date of writing, and whether its replay is equal."""
    recovered = path.with_name("recovered.mcap")
    with suppress(FileDamagedError):
        recover(path, recovered)
    recovered.unlink(missing_ok=True)
    log = read(path)
    return {
        "metadata": {key: text for key, text in log.metadata.items() if key != "started_utc"},
        "end": log.end,
        "files": log.attachments,
        "series": {
            topic: {key: value.tolist() for key, value in {"time": s.time, **s.columns}.items()}
            for topic, s in log.series.items()
        },
        "replay": replay(log).equal,
    }


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("policy", ".zip", _write_policy, _load_policy),
        Kind("library", ".npz", _write_library, _load_library),
        Kind("checkpoint", ".zip", _write_checkpoint, _load_checkpoint),
        Kind("log", ".mcap", _write_log, _load_log, archive=False, makes_folders=True),
    )
}
"""Every kind of file, by name."""
