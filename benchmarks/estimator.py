"""How well the state estimator knows the robot, and what it costs.

    python -m benchmarks.estimator

A policy walks at constant speeds and through changes of speed with noisy sensors. The first table
compares what the policy sees with the truth at the same instant, nothing removed: no bias, no
delay. NIS is the squared innovation of a foot at rest over its predicted variance, summed over the
three axes (3 where the filter is consistent; a single one is within its 95 % band from 0.22 to 9.35
if its noise is normal); NEES the same of the errors of velocity (3) and height (1). The second
table is about robots that fell and were reset. The third is time, side by side in one run.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import tyro
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

import aslip
from aslip.cassie import POLICY_PERIOD
from aslip.cassie.model import CassieIndices
from aslip.cassie.sensing import PACKET_SIZES
from aslip.envs import BatchCassieEnv
from aslip.errors import one_line_errors
from aslip.estimation import StateEstimator
from aslip.estimation.filter import P, V
from aslip.plots import save_figure
from aslip.policy import policy_stack
from aslip.run import write_text
from aslip.sim import Sensors
from aslip.stack import EPISODE_ENDS, ON_TRUTH
from aslip.task import FALL_HEIGHT

_SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)
# policy step -> commanded speed [m/s]
_CHANGES = {0: 0.0, 60: 1.0, 130: 2.0, 200: 0.3, 270: 1.5, 340: 0.0}
# ages [policy steps since the reset] of the second table
_AGES = ((0, 1), (1, 4), (4, 10), (10, 20), (20, 60))


@dataclass(frozen=True)
class Config:
    """What to measure."""

    policy: str = "aslip"
    """Who walks, as `aslip.load_policy` names it."""
    steps: int = 400
    """Policy steps of a walk."""
    repeats: int = 4
    """Robots on each walk; they differ in the noise of their sensors."""
    falls: int = 64
    """Robots that fall and are reset."""
    num_envs: int = 256
    """Robots for the cost in throughput."""
    rounds: int = 15
    """Rounds to take the median of times over."""
    seed: int = 0
    """Of the noise."""
    picture: Path = Path("runs/estimator.png")
    """Truth and estimate of the walk through changes of speed."""
    report: Path = Path("runs/estimator.json")
    """All numbers, for machines."""


@dataclass
class EstimateErrors:
    """Errors of n robots at t policy steps; NaN after a fall."""

    velocity: np.ndarray
    """(t, n, 3) estimate and truth differ by [m/s]."""
    height: np.ndarray
    """(t, n) [m]."""
    angle: np.ndarray
    """(t, n) between the estimated and the true attitude [rad]."""
    position: np.ndarray
    """(t, n, 3) [m]."""
    travelled: np.ndarray
    """(t, n) true position along x [m]."""
    nis: np.ndarray
    """(t, n) mean over packets and feet."""
    nis_inside: np.ndarray
    """(t, n) share of packets and feet within the 95 % band."""
    nees_velocity: np.ndarray
    """(t, n)."""
    nees_height: np.ndarray
    """(t, n)."""
    seen: dict[str, np.ndarray]
    """Truth and estimate themselves."""


def main(config: Config) -> None:
    """Measure, print and draw."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        walks = walk(config)
        rows = walk_rows(walks, config.repeats)
        print(walk_table(rows))
        ages = recovery(config)
        print(recovery_table(ages))
        costs = {"throughput": throughput(config), "packet": packet_time(config)}
        print(cost_table(costs, config))
    config.picture.parent.mkdir(parents=True, exist_ok=True)
    config.report.parent.mkdir(parents=True, exist_ok=True)
    save_figure(picture(walks, config.repeats), config.picture)
    write_text(config.report, json.dumps({"walks": rows, "recovery": ages, **costs}, indent=1))


# ------------------------------------------------------------------- walking


def walk(config: Config) -> EstimateErrors:
    """Walk at each speed, and through changes of speed."""
    names = [*_SPEEDS, None]
    num = len(names) * config.repeats
    env = aslip.make_env(
        num_envs=num,
        seed=config.seed,
        stack=policy_stack(config.policy),
        drop=["fall", *EPISODE_ENDS],
    )
    policy = aslip.load_policy(config.policy)
    commands = torch.tensor([_CHANGES[0] if name is None else name for name in names])
    commands = commands.repeat_interleave(config.repeats)[:, None]
    changing = torch.tensor([name is None for name in names]).repeat_interleave(config.repeats)
    initial = {"command": commands, "phase": torch.zeros(num, 1)}
    td = env.reset(TensorDict(initial, batch_size=[num]))
    estimator = StateEstimator()
    tracking, _ = estimator.start(_packets(td))
    frames: list[dict[str, np.ndarray]] = []
    for step in range(config.steps):
        if step in _CHANGES:
            td["command"] = torch.where(changing[:, None], _CHANGES[step], td["command"])
        td = cast("TensorDict", step_mdp(env.step(policy(td))))
        estimate = estimator.update(tracking, _packets(td))
        inside = np.where(estimate.resting[..., None], estimate.innovation, np.nan).sum(-1)
        variance = np.einsum("...ii->...i", tracking.belief.covariance)
        frames.append(
            {
                "inside": inside,
                "velocity_variance": variance[..., V],
                "height_variance": variance[:, 2, P],
                "command": _array(td, "command"),
                **{f"truth_{k}": _array(td, ("truth", f"pelvis_{k}")) for k in _POSE},
                **{f"estimate_{k}": _array(td, ("odometry", f"pelvis_{k}")) for k in _POSE},
                "force": _array(td, ("truth", "ground_force"))[..., 2],
                "contact": _array(td, ("estimator", "contact")),
            }
        )
    return _compare({key: np.stack([frame[key] for frame in frames]) for key in frames[0]})


_POSE = ("position", "orientation", "velocity")


def _compare(seen: dict[str, np.ndarray]) -> EstimateErrors:
    fallen = np.logical_or.accumulate(seen["truth_position"][..., 2] < FALL_HEIGHT, axis=0)
    unfallen = np.where(fallen, np.nan, 1.0)
    velocity = (seen["estimate_velocity"] - seen["truth_velocity"]) * unfallen[..., None]
    position = (seen["estimate_position"] - seen["truth_position"]) * unfallen[..., None]
    turns = [
        Rotation.from_quat(seen[f"{kind}_orientation"].reshape(-1, 4), scalar_first=True)
        for kind in ("truth", "estimate")
    ]
    low, high = chi2.ppf([0.025, 0.975], 3)
    nis = seen["inside"]
    counted = np.isfinite(nis)
    share = np.where(counted, (nis > low) & (nis < high), np.nan)
    return EstimateErrors(
        velocity=velocity,
        height=position[..., 2],
        angle=(turns[0].inv() * turns[1]).magnitude().reshape(fallen.shape) * unfallen,
        position=position,
        travelled=seen["truth_position"][..., 0] * unfallen,
        nis=_mean(nis, (2, 3)) * unfallen,
        nis_inside=_mean(share, (2, 3)) * unfallen,
        nees_velocity=(velocity**2 / seen["velocity_variance"]).sum(-1),
        nees_height=position[..., 2] ** 2 / seen["height_variance"],
        seen=seen,
    )


def walk_rows(walks: EstimateErrors, repeats: int) -> list[dict[str, Any]]:
    """One row of numbers a walk."""
    rows = []
    for i, name in enumerate([*(f"{speed:.1f}" for speed in _SPEEDS), "changes"]):
        robots = slice(i * repeats, (i + 1) * repeats)
        last = np.isfinite(walks.travelled[:, robots]).sum(0) - 1
        columns = np.arange(repeats)
        distance = walks.travelled[:, robots][last, columns] - walks.travelled[0, robots]
        slip = walks.position[:, robots, 0][last, columns] - walks.position[0, robots, 0]
        rows.append(
            {
                "walk": name,
                "velocity": np.sqrt(_mean(walks.velocity[:, robots] ** 2, (0, 1))).tolist(),
                "height": float(np.sqrt(np.nanmean(walks.height[:, robots] ** 2))),
                "angle": float(np.nanmax(walks.angle[:, robots])),
                "distance": float(distance.mean()),
                "drift": float(np.abs(slip).mean()),
                "nis": float(np.nanmean(walks.nis[:, robots])),
                "nis_inside": float(np.nanmean(walks.nis_inside[:, robots])),
                "nees_velocity": float(np.nanmean(walks.nees_velocity[:, robots])),
                "nees_height": float(np.nanmean(walks.nees_height[:, robots])),
                "fallen": int((last < len(walks.travelled) - 1).sum()),
            }
        )
    return rows


def walk_table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    lines = [
        "| walk [m/s] | velocity RMSE x, y, z [m/s] | height RMSE [mm] | attitude, worst [deg]"
        " | drift of x [m] | of the way | NIS | in band | NEES velocity | height | falls |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        share = f"{100 * row['drift'] / row['distance']:.1f} %" if row["distance"] > 1 else "-"
        velocity = ", ".join(f"{value:.3f}" for value in row["velocity"])
        lines.append(
            f"| {row['walk']} | {velocity} | {1e3 * row['height']:.1f}"
            f" | {np.rad2deg(row['angle']):.2f} | {row['drift']:.2f} | {share} | {row['nis']:.1f}"
            f" | {100 * row['nis_inside']:.0f} % | {row['nees_velocity']:.1f}"
            f" | {row['nees_height']:.1f} | {row['fallen']} |"
        )
    return "\n".join(lines)


# ------------------------------------------------------------------ recovery


def recovery(config: Config) -> list[dict[str, Any]]:
    """Make robots fall, and watch the estimate from their reset on."""
    env = aslip.make_env(num_envs=config.falls, seed=config.seed, stack=policy_stack(config.policy))
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
                _array(td, ("odometry", "pelvis_velocity"))
                - _array(td, ("truth", "pelvis_velocity")),
                _array(td, ("estimate", "height"))
                - _array(td, ("truth", "pelvis_position"))[:, 2:],
            ]
        )
        errors.append((age.numpy().copy(), error))
    ages = np.concatenate([age for age, _ in errors])
    error = np.concatenate([error for _, error in errors])
    rows = []
    for low, high in _AGES:
        chosen = error[(ages >= low) & (ages < high)]
        rms = np.sqrt((chosen**2).mean(0))
        rows.append(
            {"from": low, "to": high, "velocity": rms[:3].tolist(), "height": float(rms[3]),
             "samples": len(chosen)}
        )  # fmt: skip
    return rows


def recovery_table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    lines = [
        "\n| policy steps after a fall and reset | velocity RMSE x, y, z [m/s] | height RMSE [mm]"
        " | samples |",
        "|---|---|---:|---:|",
    ]
    for row in rows:
        ages = (
            f"{row['from']}" if row["to"] == row["from"] + 1 else f"{row['from']}-{row['to'] - 1}"
        )
        velocity = ", ".join(f"{value:.3f}" for value in row["velocity"])
        lines.append(f"| {ages} | {velocity} | {1e3 * row['height']:.1f} | {row['samples']} |")
    return "\n".join(lines)


# ---------------------------------------------------------------------- cost


class _NoSensors:
    """In place of `Sensors`: the PD loop works on the truth, packets stay as they are."""

    def __init__(self, sensors: Sensors, indices: CassieIndices) -> None:
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
        """Nothing to forget."""

    feel = reset

    def finish(self) -> None:
        """Nothing to compute."""


def throughput(config: Config) -> dict[str, float]:
    """Policy steps per second of whole environments, in turn, by what the robot senses."""
    variants: dict[str, Mapping[str, Any]] = {
        "truth, no sensors": ON_TRUTH,
        "truth, sensors": ON_TRUTH,
        "estimator": {"drop": ["noise"]},
        "estimator and noise": {},
    }
    envs = {
        name: aslip.make_env(
            num_envs=config.num_envs, seed=config.seed, stack=policy_stack(config.policy), **edit
        )
        for name, edit in variants.items()
    }
    base = envs["truth, no sensors"].base_env
    assert isinstance(base, BatchCassieEnv)
    for part in base.simulations.parts:
        part.sensors = cast("Sensors", _NoSensors(part.sensors, part.indices))
    policy = aslip.load_policy(config.policy)
    states = {name: cast("TensorDictBase", env.reset()) for name, env in envs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in envs}
    for _ in range(config.rounds + 2):
        for name, env in envs.items():
            policy(states[name])
            # torch's threads go on spinning for a while after their work
            time.sleep(0.01)
            start = time.perf_counter()
            _, states[name] = env.step_and_maybe_reset(states[name])
            seconds[name].append(time.perf_counter() - start)
    whole = [config.num_envs / s for s in seconds["truth, no sensors"][2:]]
    table = {"truth, no sensors": statistics.median(whole)}
    for name in list(variants)[1:]:
        pairs = zip(seconds["truth, no sensors"][2:], seconds[name][2:], strict=True)
        table[name] = table["truth, no sensors"] * statistics.median(a / b for a, b in pairs)
    return table


def packet_time(config: Config) -> float:
    """Median seconds for one packet of one robot."""
    env = aslip.make_env(seed=config.seed, stack=policy_stack(config.policy))
    policy, td = aslip.load_policy(config.policy), cast("TensorDictBase", env.reset())
    packets = []
    for _ in range(60):
        _, td = env.step_and_maybe_reset(policy(td))
        packets.extend(_packets(td)[0])
    estimator = StateEstimator()
    tracking, _ = estimator.start(packets[0])
    seconds = []
    for packet in packets[1:]:
        start = time.perf_counter()
        estimator.update(tracking, packet)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def cost_table(costs: dict[str, Any], config: Config) -> str:
    """Markdown."""
    best = costs["throughput"]["truth, no sensors"]
    lines = [
        f"\n| N = {config.num_envs} | policy steps/s | share |",
        "|---|---:|---:|",
        *(
            f"| {name} | {rate:.0f} | {100 * rate / best:.0f} % |"
            for name, rate in costs["throughput"].items()
        ),
        f"\nOne packet of one robot: {1e6 * costs['packet']:.0f} us",
    ]
    return "\n".join(lines)


# ------------------------------------------------------------------- picture


def picture(walks: EstimateErrors, repeats: int) -> Figure:
    """Truth and estimate of the first walk through changes of speed."""
    robot = len(_SPEEDS) * repeats
    seen = {key: values[:, robot] for key, values in walks.seen.items()}
    seconds = POLICY_PERIOD * np.arange(1, len(seen["force"]) + 1)
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    for i, name in enumerate("xyz"):
        axes[i].plot(seconds, seen["truth_velocity"][:, i], "k", lw=1.6, label="truth")
        axes[i].plot(seconds, seen["estimate_velocity"][:, i], "tab:red", lw=1, label="estimate")
        axes[i].set_ylabel(f"velocity {name} [m/s]")
    axes[0].step(seconds, seen["command"][:, 0], "0.6", lw=1, where="pre", label="command")
    axes[3].plot(seconds, seen["truth_position"][:, 2], "k", lw=1.6)
    axes[3].plot(seconds, seen["estimate_position"][:, 2], "tab:red", lw=1)
    axes[3].set_ylabel("height [m]")
    for i, (side, color) in enumerate((("left", "tab:blue"), ("right", "tab:green"))):
        axes[4].plot(seconds, seen["force"][:, i], color, lw=0.8, label=f"{side} foot")
        axes[4].fill_between(
            seconds, -150 - 60 * i, -100 - 60 * i, where=seen["contact"][:, i], color=color, lw=0
        )
    axes[4].set_ylabel("ground force [N]\n(bars: estimated contact)")
    axes[4].set_xlabel("time [s]")
    axes[0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[4].legend(loc="upper right", ncols=2, fontsize=8)
    figure.suptitle("State estimate of a walk through changes of speed, noisy sensors")
    return figure


# ------------------------------------------------------------------- helpers


def _packets(td: TensorDictBase) -> np.ndarray:
    """(n, w, 42) the sensors' packets, after noise."""
    return np.concatenate([_array(td, ("sensors", name)) for name in PACKET_SIZES], axis=-1)


def _array(td: TensorDictBase, key: Any) -> np.ndarray:
    value = cast("torch.Tensor", td[key])
    return value.double().numpy() if value.is_floating_point() else value.numpy()


def _mean(values: np.ndarray, axis: tuple[int, ...]) -> np.ndarray:
    """Mean of what is a number; NaN where nothing is."""
    counted = np.isfinite(values)
    total, number = np.where(counted, values, 0.0).sum(axis), counted.sum(axis)
    return np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Config))
