"""State estimator: errors and consistency on walks, recovery after resets, cost.

    python -m benchmarks.system.estimator

A policy walks at constant and changing speeds with noisy sensors. The first table compares the
observed estimate with the truth at the same instant, bias and delay included. NIS is the normalised
innovation squared of a foot in stance: for a consistent filter its mean is 3 and 95 % of values lie
between 0.22 and 9.35. NEES is the normalised estimation error squared of velocity (mean 3) and
height (mean 1). The second table shows the recovery after falls and resets.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    policy: str = "straight"
    """Policy that walks, as `aslip.load_policy` takes it."""
    steps: int = 400
    """Policy steps of each walk."""
    repeats: int = 4
    """Robots on each walk, with different sensor noise."""
    falls: int = 64
    """Number of robots that fall and are reset."""
    ages: tuple[int, ...] = (0, 1, 4, 10, 20, 60)
    """Ends of the ranges of policy steps since a reset, in the second table."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder for tables, numbers and picture."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
import statistics
import time
from collections.abc import Mapping
from contextlib import closing
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from aslip.envs import StackEnv
from aslip.estimation import StateEstimator
from benchmarks.common import MakeEnv, Policy, Subject, table, write_results
from benchmarks.system.estimate_errors import (
    WALK_COLUMNS,
    array,
    packets,
    picture,
    record_estimates,
    walk_rows,
)


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> None:
    """Measure, print and draw.

    Args:
        config: the settings.
        policy: policy that walks; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    subject = Subject.load(policy or config.policy, make_env)
    walks = record_estimates(subject, config.steps, config.repeats, config.seed)
    rows = walk_rows(walks, config.repeats)
    ages = recovery(config, subject)
    seconds = packet_time(config, subject)
    cost = f"One packet of one robot: {1e6 * seconds:.0f} us"
    text = "\n\n".join([table(WALK_COLUMNS, rows), table(RECOVERY_COLUMNS, ages), cost])
    numbers = {"policy": subject.name, "seed": config.seed, "walks": rows, "recovery": ages}
    figure = picture(walks, config.repeats)
    write_results(config.out, "estimator", {**numbers, "packet": seconds}, text, figure)


# ------------------------------------------------------------------------- recovery


def recovery(config: Config, subject: Subject) -> list[dict[str, Any]]:
    """Compare estimate and truth after falls and resets, by policy steps since the reset."""
    with closing(subject.env(config.falls, seed=config.seed)) as env:
        ages, error = _errors_by_age(config, subject, env)
    rows = []
    for low, high in itertools.pairwise(config.ages):
        chosen = error[(ages >= low) & (ages < high)]
        rms = np.sqrt((chosen**2).mean(0))
        rows.append(
            {"from": low, "to": high, "velocity": rms[:3].tolist(), "height": float(rms[3]),
             "samples": len(chosen)}
        )  # fmt: skip
    return rows


@torch.no_grad()
@set_exploration_type(ExplorationType.DETERMINISTIC)
def _errors_by_age(
    config: Config, subject: Subject, env: StackEnv
) -> tuple[np.ndarray, np.ndarray]:
    """Policy steps since the reset (k,), and errors (k, 4) of velocity and height."""
    generator = torch.Generator().manual_seed(config.seed)
    td = cast("TensorDictBase", env.reset())
    oldest = config.ages[-1]
    age = torch.full(
        (config.falls,), oldest
    )  # robots of this age get random actions until they fall
    errors: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(3 * oldest):
        subject.policy(td)
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


def _age(row: Mapping[str, Any]) -> str:
    """Cell of a range of policy steps."""
    first, last = row["from"], row["to"] - 1
    return f"{first}" if first == last else f"{first}-{last}"


RECOVERY_COLUMNS = {
    "policy steps since reset": _age,
    "velocity RMSE x, y, z [m/s]": lambda row: ", ".join(f"{v:.3f}" for v in row["velocity"]),
    "height RMSE [mm]": lambda row: f"{1e3 * row['height']:.1f}",
    "samples": "{samples}",
}


# ----------------------------------------------------------------------------- cost


@torch.no_grad()
@set_exploration_type(ExplorationType.DETERMINISTIC)
def packet_time(config: Config, subject: Subject) -> float:
    """Median time for one packet of one robot [s]."""
    sensed: list[np.ndarray] = []
    with closing(subject.env(1, seed=config.seed)) as env:
        td = cast("TensorDictBase", env.reset())
        for _ in range(60):
            _, td = env.step_and_maybe_reset(subject.policy(td))
            sensed.extend(packets(td)[0])
    estimator = StateEstimator()
    tracking, _ = estimator.start(sensed[0])
    seconds = []
    for packet in sensed[1:]:
        start = time.perf_counter()
        estimator.update(tracking, packet)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
