"""What the estimator makes of robots that were reset."""

from __future__ import annotations

from contextlib import closing
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase

import aslip
from aslip.envs import StackEnv
from aslip.policy import policy_stack
from aslip.walking import markdown
from benchmarks.estimator.arrays import array
from benchmarks.estimator.config import Config

# ages [policy steps since the reset] of the table
_AGES = ((0, 1), (1, 4), (4, 10), (10, 20), (20, 60))


def recovery(config: Config) -> list[dict[str, Any]]:
    """Make robots fall, and watch the estimate from their reset on."""
    stack = policy_stack(config.policy)
    with closing(aslip.make_env(num_envs=config.falls, seed=config.seed, stack=stack)) as env:
        ages, error = _watched(config, env)
    rows = []
    for low, high in _AGES:
        chosen = error[(ages >= low) & (ages < high)]
        rms = np.sqrt((chosen**2).mean(0))
        rows.append(
            {"from": low, "to": high, "velocity": rms[:3].tolist(), "height": float(rms[3]),
             "samples": len(chosen)}
        )  # fmt: skip
    return rows


def _watched(config: Config, env: StackEnv) -> tuple[np.ndarray, np.ndarray]:
    """Policy steps since the reset (k,), and errors (k, 4) of velocity and height then."""
    policy = aslip.load_policy(config.policy)
    generator = torch.Generator().manual_seed(config.seed)
    td = cast("TensorDictBase", env.reset())
    oldest = _AGES[-1][1]
    age = torch.full((config.falls,), oldest)  # old robots are made to fall
    errors: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(3 * oldest):
        policy(td)
        falling = age >= oldest
        wild = torch.randn(td["action"].shape, generator=generator)
        td["action"] = torch.where(falling[:, None], wild, td["action"])
        result, td = env.step_and_maybe_reset(td)
        done = result["next", "done"][:, 0]
        age = torch.where(done & falling, 0, torch.where(done, oldest, age + (~falling).long()))
        error = np.column_stack(
            [
                array(td, ("odometry", "pelvis_velocity"))
                - array(td, ("true_odometry", "pelvis_velocity")),
                array(td, ("estimate", "height"))
                - array(td, ("true_odometry", "pelvis_position"))[:, 2:],
            ]
        )
        errors.append((age.numpy().copy(), error))
    return np.concatenate([age for age, _ in errors]), np.concatenate([e for _, e in errors])


def recovery_table(rows: list[dict[str, Any]]) -> str:
    """A row a range of ages."""
    header = [
        "policy steps after a fall and reset", "velocity RMSE x, y, z m/s", "height RMSE mm",
        "samples",
    ]  # fmt: skip
    cells = []
    for row in rows:
        first, last = row["from"], row["to"] - 1
        cells.append(
            [
                f"{first}" if first == last else f"{first}-{last}",
                ", ".join(f"{value:.3f}" for value in row["velocity"]),
                f"{1e3 * row['height']:.1f}",
                str(row["samples"]),
            ]
        )
    return markdown(header, cells)
