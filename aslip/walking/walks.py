"""Walks of a policy as arrays, for metrics: simulated, or read from a log."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from aslip.envs import StackEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import SIDES

_FEET = tuple(f"{side}_foot_position" for side in SIDES)


@dataclass(frozen=True)
class Walks:
    """n walks of m policy steps. Rows are the instants at which the steps end.

    What comes after a fall is NaN but for `alive` and `command`. Places, orientations and
    velocities are in the robot's heading frame, see `aslip.transforms.HeadingFrame`.
    """

    command: np.ndarray
    """(m, n) commanded speed during the step [m/s]."""
    alive: np.ndarray
    """(m, n) whether the walk has not ended, in a fall or otherwise."""
    phase: np.ndarray
    """(m, n) stride fraction."""
    reward: np.ndarray
    """(m, n)."""
    action: np.ndarray
    """(m, n, 10) [rad]."""
    pelvis_position: np.ndarray
    """(m, n, 3) [m]."""
    pelvis_orientation: np.ndarray
    """(m, n, 4) wxyz."""
    pelvis_velocity: np.ndarray
    """(m, n, 3) [m/s]."""
    foot_position: np.ndarray
    """(m, n, 2, 3) sole centres, left and right [m]."""
    ground_force: np.ndarray
    """(m, n, 2, 3) means over the steps [N, world]."""
    body_position: np.ndarray
    """(m, n, 3) of the reduced-order model; x is the deviation from uniform motion [m]."""
    body_velocity: np.ndarray
    """(m, n, 3) of the reduced-order model [m/s]."""
    body_to_foot: np.ndarray
    """(m, n, 2, 3) feet of the reduced-order model, from its body [m]."""

    def __post_init__(self) -> None:
        """Check that arrays fit together.

        Raises:
            ShapeError: they do not.
        """
        for field in fields(self):
            shape = getattr(self, field.name).shape
            if shape[:2] != self.command.shape:
                raise ShapeError(
                    f"{field.name} must begin with {self.command.shape} as the command, got {shape}"
                )

    @property
    def survived(self) -> np.ndarray:
        """(n,) whether each walk lasted."""
        return self.alive[-1]

    def one(self, index: int, start: int = 0, stop: int | None = None) -> Walks:
        """Some steps of one walk, n = 1."""
        rows = slice(start, stop), slice(index, index + 1)
        return Walks(*(getattr(self, field.name)[rows] for field in fields(self)))


@torch.no_grad()
def record_walks(policy: TensorDictModuleBase, env: StackEnv, command: np.ndarray) -> Walks:
    """Walk from phase 0 without exploration noise.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: of n robots; leave out its `aslip.envs.EPISODE_ENDS` transforms to see whole walks.
        command: (m, n) commanded speed of each policy step [m/s].

    Raises:
        ShapeError: `command` is not for n robots, or has no policy step.
        ConfigurationError: a command is not finite.
    """
    command = np.asarray(command, dtype=np.float32)
    if command.ndim != 2 or command.shape[1] != env.num_envs:
        raise ShapeError(f"command must be (m, {env.num_envs}), got {command.shape}")
    if not len(command):
        raise ShapeError(f"command must have a row for each policy step, got {command.shape}")
    if not np.isfinite(command).all():
        raise ConfigurationError("every commanded speed must be finite")
    n = env.num_envs
    first = torch.from_numpy(command[0])[:, None].clone()
    td = env.reset(TensorDict(command=first, phase=torch.zeros(n, 1), batch_size=n))
    alive = torch.ones(n, dtype=torch.bool)
    rows: list[dict[str, np.ndarray]] = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for speeds in torch.from_numpy(command):
            td["command"] = speeds[:, None].clone()
            td = env.step(policy(td))
            after = cast("TensorDictBase", td["next"])
            alive = alive & ~after["terminated"][:, 0]
            rows.append(_row(td, after, alive))
            td = step_mdp(td)
    return Walks(**{name: np.stack([row[name] for row in rows]) for name in rows[0]})


def _row(td: TensorDictBase, after: TensorDictBase, alive: torch.Tensor) -> dict[str, np.ndarray]:
    truth, body, reference = (
        cast("TensorDictBase", after[name]) for name in ("truth", "true_odometry", "reference")
    )
    values = {
        "phase": after["phase"][:, 0],
        "reward": after["reward"][:, 0],
        "action": td["action"],
        "pelvis_position": body["pelvis_position"],
        "pelvis_orientation": body["pelvis_orientation"],
        "pelvis_velocity": body["pelvis_velocity"],
        "foot_position": torch.stack([body[name] for name in _FEET], dim=1),
        "ground_force": truth["ground_force"],
        "body_position": reference["body_position"],
        "body_velocity": reference["body_velocity"],
        "body_to_foot": torch.stack([reference[name] for name in _FEET], dim=1),
    }
    row = {name: value.double().numpy().copy() for name, value in values.items()}
    for value in row.values():
        value[~alive.numpy()] = np.nan
    command = td["command"][:, 0].double().numpy()
    return {"command": np.asarray(command), "alive": alive.numpy().copy(), **row}
