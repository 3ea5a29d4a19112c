"""State estimator: errors and consistency on walks, recovery after resets, cost.

    python -m benchmarks.system.estimator

A policy walks at constant and changing speeds with noisy sensors. The first table compares the
observed estimate with the truth at the same instant, bias and delay included. NIS is the normalised
innovation squared of a foot in stance: for a consistent filter its mean is 3 and 95 % of values lie
between 0.22 and 9.35. NEES is the normalised estimation error squared of velocity (mean 3) and
height (mean 1). The second table shows the recovery after falls and resets, the third the cost,
measured side by side in one run.
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
    num_envs: int = 256
    """Number of robots in the throughput measurement."""
    rounds: int = 15
    """Number of rounds; tables show the median."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder for tables, numbers and picture."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import statistics
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from aslip.base.tables import markdown
from aslip.envs import ON_TRUTH, BatchEnv, StackEnv
from aslip.estimation import StateEstimator
from aslip.robot import Indices
from aslip.sim import Sensors
from benchmarks.common import MakeEnv, Policy, Subject, write_results
from benchmarks.system.estimate_errors import (
    array,
    packets,
    picture,
    record_estimates,
    walk_rows,
    walk_table,
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
    costs = {
        "throughput": throughput(config, subject),
        "packet": packet_time(config, subject),
    }
    text = "\n\n".join([walk_table(rows), recovery_table(ages), cost_table(costs, config)])
    numbers = {"policy": subject.name, "seed": config.seed, "walks": rows, "recovery": ages}
    figure = picture(walks, config.repeats)
    write_results(config.out, "estimator", {**numbers, **costs}, text, figure)


# ------------------------------------------------------------------------- recovery

# ages [policy steps since the reset] of the table
_AGES = ((0, 1), (1, 4), (4, 10), (10, 20), (20, 60))


def recovery(config: Config, subject: Subject) -> list[dict[str, Any]]:
    """Compare estimate and truth after falls and resets, by policy steps since the reset."""
    with closing(subject.env(config.falls, seed=config.seed)) as env:
        ages, error = _errors_by_age(config, subject, env)
    rows = []
    for low, high in _AGES:
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
    oldest = _AGES[-1][1]
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


def recovery_table(rows: list[dict[str, Any]]) -> str:
    """Table of errors after a reset, a row for each range of policy steps."""
    header = [
        "policy steps since reset", "velocity RMSE x, y, z [m/s]", "height RMSE [mm]",
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


# ----------------------------------------------------------------------------- cost


class _NoSensors:
    """Replacement for `Sensors`: PD control on the true state, constant packets."""

    def __init__(self, sensors: Sensors, indices: Indices) -> None:
        self._packets = sensors.packets()
        self._indices = indices
        self.motor_position, self.motor_velocity = sensors.motor_position, sensors.motor_velocity

    def read(self, substep: int, qpos: np.ndarray, qvel: np.ndarray) -> None:
        del substep
        np.take(qpos, self._indices.motor_qpos, axis=1, out=self.motor_position)
        np.take(qvel, self._indices.motor_qvel, axis=1, out=self.motor_velocity)

    def packets(self) -> dict[str, np.ndarray]:
        return self._packets

    def reset(self, *_: object) -> None:
        """Do nothing."""

    feel = reset

    def finish(self) -> None:
        """Do nothing."""


def throughput(config: Config, subject: Subject) -> dict[str, float]:
    """Policy steps per second of environments, by kind of sensing."""
    variants: dict[str, Mapping[str, Any]] = {
        "truth, no sensors": ON_TRUTH,
        "truth, sensors": ON_TRUTH,
        "estimator": {"drop": ["noise"]},
        "estimator and noise": {},
    }
    with ExitStack() as stack:
        envs = {
            name: stack.enter_context(
                closing(subject.env(config.num_envs, seed=config.seed, **edit))
            )
            for name, edit in variants.items()
        }
        seconds = _time_steps(config, subject, envs)
    whole = [config.num_envs / s for s in seconds["truth, no sensors"][2:]]
    table = {"truth, no sensors": statistics.median(whole)}
    for name in list(variants)[1:]:
        pairs = zip(seconds["truth, no sensors"][2:], seconds[name][2:], strict=True)
        table[name] = table["truth, no sensors"] * statistics.median(a / b for a, b in pairs)
    return table


@torch.no_grad()
@set_exploration_type(ExplorationType.DETERMINISTIC)
def _time_steps(
    config: Config, subject: Subject, envs: Mapping[str, StackEnv]
) -> dict[str, list[float]]:
    """Wall times of each environment's policy steps [s]."""
    base = envs["truth, no sensors"].base_env
    assert isinstance(base, BatchEnv)
    for part in base.simulations.parts:
        part.sensors = cast("Sensors", _NoSensors(part.sensors, part.indices))
    states = {name: cast("TensorDictBase", env.reset()) for name, env in envs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in envs}
    for _ in range(config.rounds + 2):
        for name, env in envs.items():
            subject.policy(states[name])
            # torch's threads spin for a while after their work
            time.sleep(0.01)
            start = time.perf_counter()
            _, states[name] = env.step_and_maybe_reset(states[name])
            seconds[name].append(time.perf_counter() - start)
    return seconds


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


def cost_table(costs: dict[str, Any], config: Config) -> str:
    """Table of throughput, a row for each kind of sensing, and the time of a packet."""
    best = costs["throughput"]["truth, no sensors"]
    rows = [
        [name, f"{rate:.0f}", f"{100 * rate / best:.0f} %"]
        for name, rate in costs["throughput"].items()
    ]
    table = markdown([f"N = {config.num_envs}", "policy steps/s", "share"], rows)
    return f"{table}\n\nOne packet of one robot: {1e6 * costs['packet']:.0f} us"


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
