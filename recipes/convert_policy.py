"""Rewrite a policy of an earlier version of this package in today's format.

    python recipes/convert_policy.py runs/mine/policy.zip

Earlier files have no hashes. Nothing tells whether such a file was changed since it was written:
convert those that you wrote yourself. The weights stay as they are, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from aslip.errors import FileDamagedError, one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Which file."""

    path: Annotated[Path, tyro.conf.Positional]
    """The policy's file; replaced as a whole."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import zipfile
from typing import Any

from tensordict import TensorDict
from tensordict.utils import unravel_key
from torchrl.checkpoint import Checkpoint

from aslip.policy import PolicyShape, RunningNormalizer, make_actor, save_policy

# what follows from statistics and names
_DERIVED = ("._offset", "._scale", "puts.index", "puts.sign")
_BASELINES = {
    "aslip": ("reference", "motor_target"),
    "paper": ("reference", "motor_position"),
    "single_reference": ("reference", "motor_position"),
}


class _Weights:
    """Takes a state as it is."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}

    def state_dict(self) -> dict[str, Any]:
        return self.state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.state = state


def main(config: Config) -> None:
    """Convert one file.

    Raises:
        FileDamagedError: it is no policy of an earlier version.
    """
    try:
        _refuse_programs(config.path)
        card = Checkpoint.manifest(config.path)["metadata"]
        weights = _Weights()
        Checkpoint(actor=weights).load(config.path)
        shape = PolicyShape(**{**card["shape"], "hidden": tuple(card["shape"]["hidden"])})
        observation = [unravel_key(tuple(name.split("/"))) for name in card["observation"]]
        actor = make_actor(RunningNormalizer(shape.observation_size), shape, observation)
        kept = {k: v for k, v in weights.state.items() if not k.endswith(_DERIVED)}
        actor.load_state_dict(kept)
    except Exception as error:  # one cause, a bad file, has many exceptions
        raise FileDamagedError(
            f"{str(config.path)!r} is no policy of an earlier version"
            f" ({type(error).__name__}: {error})"
        ) from error
    # policies of before there were several stacks act on the paper's
    stack = card.get("stack", "paper")
    save_policy(
        config.path,
        actor,
        shape,
        card.get("made_by"),
        stack=stack,
        observation=observation,
        baseline=_BASELINES.get(stack),
    )
    print(f"{config.path} is a policy of today's format; its stack is {stack!r}")


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


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
