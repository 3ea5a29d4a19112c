"""How a policy follows its commanded speed: through a schedule, at each speed, and after changes.

    python -m benchmarks.velocity_tracking                                 # the shipped policy
    python -m benchmarks.velocity_tracking --policy runs/seed0 runs/seed1 runs/seed2
    python -m benchmarks.velocity_tracking --log walk.mcap                 # the walk in a log

The schedule is the paper's: 0, 0.8, 1.9, 0.4, 1.3, 0.5 m/s, four seconds each. Beside it a map of
mean against commanded speed at all speeds, also below 0.3 m/s, and the answers to steps of 1 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line
from benchmarks.flags import Common


@dataclass(frozen=True)
class Config(Common):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = tuple(i / 10 for i in range(21))
    """Commanded speeds of the map [m/s]."""
    log: Path | None = None
    """Draw and measure the schedule of a log instead, and nothing else."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import itertools
import math
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from aslip.library import GaitLibrary
from aslip.log import read, read_walk
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.show.ghost import Footholds
from aslip.walking import TRACKING_TOLERANCE, Walks, is_on_feet, markdown, tracks_command
from aslip.walking.metrics import (
    StepResponse,
    root_mean_square,
    stances,
    step_response,
    stride_average,
    touchdown_spike,
)
from benchmarks.common import Interval, constant_walks, walks_of, write_report

SCHEDULE: Final = (0.0, 0.8, 1.9, 0.4, 1.3, 0.5)
"""Commanded speeds [m/s], of `_HOLD` seconds each."""

STEPS: Final = ((0.0, 1.0), (1.0, 2.0), (0.5, 1.5), (1.5, 0.5), (2.0, 1.0), (1.0, 0.0))
"""Sudden changes of command [m/s]."""

PUBLISHED: Final = MappingProxyType(
    {0.0: -0.005, 0.4: 0.397, 0.5: 0.484, 0.8: 0.778, 1.3: 1.278, 1.9: 1.898}
)
"""Commanded -> mean speed [m/s] of the authors' recording of the schedule, after 1.5 s each."""

_HOLD = 4.0  # [s]
# after a change of command, before the mean of a speed is taken [s]
_TRANSIENT = 1.5
# walking before a sudden change and after it [s]; and to map the speeds
_BEFORE, _AFTER = 4.0, 4.0
_SETTLE, _WALK = 4.0, 8.0
# of the robot itself, which all walks here are of [N]
_WEIGHT = CASSIE.total_mass * STANDARD_GRAVITY
# around a touchdown, where the model's speed spikes [policy steps]
_SPIKE = 2


def main(config: Config) -> dict[str, Any]:
    """Measure, print and draw; returns the numbers."""
    footholds = Footholds(GaitLibrary.load())
    if config.log is not None:
        walks = [read_walk(read(config.log))]
        numbers: dict[str, Any] = {"schedule": schedule_rows(walks)}
        figure = picture(walks[0], [])
        write_report(config, "velocity_tracking", numbers, schedule_table(numbers), figure)
        return numbers
    steps = round(_HOLD / CASSIE.policy_period)
    command = np.repeat(SCHEDULE, steps)[:, None]
    walks = [walks_of(config, policy, command) for policy in config.policy]
    numbers = {
        "schedule": schedule_rows(walks),
        "map": map_rows(config),
        "steps": step_rows(config, footholds),
        "spike": spikes(walks),
    }
    tables = [schedule_table(numbers), map_table(numbers), step_table(numbers)]
    figure = picture(walks[0], numbers["map"], len(walks))
    write_report(config, "velocity_tracking", numbers, "\n\n".join(tables), figure)
    return numbers


# --------------------------------------------------------------------- schedule


def schedule_rows(walks: list[Walks]) -> list[dict[str, float]]:
    """Mean speeds of each part of a schedule after its transient, robot and model."""
    command = walks[0].command[:, 0]
    bounds = [0, *np.flatnonzero(np.diff(command)) + 1, len(command)]
    rows = []
    for start, stop in itertools.pairwise(bounds):
        steady = slice(min(start + round(_TRANSIENT / CASSIE.policy_period), stop - 1), stop)
        robot = [walk.pelvis_velocity[steady, 0, 0] for walk in walks]
        model = walks[0].body_velocity[steady, 0, 0]
        off = [walk.pelvis_velocity[steady, 0, 0] - walk.body_velocity[steady, 0, 0]
               for walk in walks]  # fmt: skip
        speed = float(command[start])
        published = [value for key, value in PUBLISHED.items() if abs(key - speed) < 1e-6]
        rows.append(
            {
                "command": speed,
                "robot": float(np.mean([part.mean() for part in robot])),
                "robot_std": float(np.mean([part.std() for part in robot])),
                "model": float(model.mean()),
                "rms": float(np.mean([float(root_mean_square(part)) for part in off])),
                "published": published[0] if published else math.nan,
            }
        )
    return rows


def schedule_table(numbers: dict[str, Any]) -> str:
    """The schedule's parts."""
    rows = [
        [f"{row[key]:.3f}" for key in ("command", "robot", "robot_std", "model", "rms")]
        + [f"{row['published']:.3f}" if math.isfinite(row["published"]) else ""]
        for row in numbers["schedule"]
    ]
    header = ["command m/s", "robot m/s", "oscillation", "model m/s", "rms to model", "published"]
    return markdown(header, rows)


def spikes(walks: list[Walks]) -> dict[str, Any]:
    """Mean range of speed around the model's touchdowns, robot and model [m/s]."""
    each = [spike(walk) for walk in walks]
    means = {name: float(np.mean([one[name] for one in each])) for name in ("robot", "model")}
    return {**means, "each": each}


def spike(walk: Walks) -> dict[str, float]:
    """The same of one walk."""
    # the model's foot is down where it does not rise above the floor
    height = walk.body_position[:, :1, 2] + walk.body_to_foot[:, 0, :, 2]
    model, robot = walk.body_velocity[:, 0, 0], walk.pelvis_velocity[:, 0, 0]
    down = [stances(np.where(h < 1e-3, 100.0, 0.0), CASSIE.policy_period)[:, 0] for h in height.T]
    return {
        name: float(np.nanmean([touchdown_spike(speed, samples, _SPIKE) for samples in down]))
        for name, speed in (("robot", robot), ("model", model))
    }


# -------------------------------------------------------------------------- map


def map_rows(config: Config) -> list[dict[str, Any]]:
    """Mean speed at each commanded one, and who survived, on the feet, and tracked it."""
    walks = constant_walks(config, config.speeds, _SETTLE + _WALK)
    first = round(_SETTLE / CASSIE.policy_period)
    rows = []
    for i, speed in enumerate(config.speeds):
        means = np.array([mean_velocity(walk.pelvis_position[first:, i, :2]) for walk in walks])
        each = means[:, 0].tolist()
        drift = np.abs(means[:, 1]).mean()
        carried = [walk.ground_force[first:, i, :, 2].sum(1).mean() / _WEIGHT for walk in walks]
        rows.append(
            {
                "command": speed,
                **vars(Interval.of([np.array([mean]) for mean in each])),
                "each": each,
                "sideways": float(drift),
                "survived": [bool(walk.survived[i]) for walk in walks],
                # NaN, where it fell, is neither
                "on_feet": [bool(is_on_feet(ratio, _WALK)) for ratio in carried],
                "tracked": [bool(tracks_command(speed, mean)) for mean in each],
            }
        )
    return rows


def mean_velocity(position: np.ndarray) -> np.ndarray:
    """(2,) of a walk's positions (m, 2) at the ends of policy steps [m/s]."""
    return (position[-1] - position[0]) / ((len(position) - 1) * CASSIE.policy_period)


def map_table(numbers: dict[str, Any]) -> str:
    """The map's speeds."""
    rows = [
        [
            f"{row['command']:.1f}",
            f"{row['mean']:.3f}",
            f"{row['mean'] - row['command']:+.3f}",
            f"{row['sideways']:.3f}",
            *(f"{sum(row[key])} of {len(row[key])}" for key in ("survived", "on_feet", "tracked")),
        ]
        for row in numbers["map"]
    ]
    header = ["command m/s", "mean m/s", "off m/s", "sideways m/s", "survived", "on the feet"]
    return markdown([*header, f"tracked within {TRACKING_TOLERANCE:g} m/s"], rows)


# ------------------------------------------------------------------------ steps


def step_rows(config: Config, footholds: Footholds) -> list[dict[str, Any]]:
    """Answers to sudden changes of command."""
    before, after = (round(time / CASSIE.policy_period) for time in (_BEFORE, _AFTER))
    changes = np.array(STEPS).T
    command = np.concatenate([np.tile(changes[0], (before, 1)), np.tile(changes[1], (after, 1))])
    walks = [walks_of(config, policy, command) for policy in config.policy]
    rows = []
    for i, (old, new) in enumerate(STEPS):
        answers = [answer(walk, i, before, footholds) for walk in walks]
        rows.append(
            {
                "from": old,
                "to": new,
                "settling": float(np.mean([a.settling_time for a in answers])),
                "overshoot": float(np.mean([a.overshoot for a in answers])),
                "steady_error": float(np.mean([a.steady_error for a in answers])),
                "each": {
                    "settling": [a.settling_time for a in answers],
                    "steady_error": [a.steady_error for a in answers],
                },
            }
        )
    return rows


def answer(walk: Walks, index: int, change: int, footholds: Footholds) -> StepResponse:
    """One walk's answer; a fall never settles."""
    old, new = walk.command[change - 1, index], walk.command[change, index]
    if not walk.survived[index]:
        return StepResponse(math.inf, math.nan, math.nan)
    speed = walk.pelvis_velocity[change:, index, 0]
    return step_response(speed, old, new, footholds.stride(new), CASSIE.policy_period)


def step_table(numbers: dict[str, Any]) -> str:
    """The changes."""
    rows = [
        [
            f"{row['from']:.1f} to {row['to']:.1f}",
            f"{row['settling']:.2f}" if math.isfinite(row["settling"]) else "not",
            f"{row['overshoot']:.2f}",
            f"{row['steady_error']:+.3f}",
        ]
        for row in numbers["steps"]
    ]
    return markdown(["change m/s", "settled after s", "overshoot m/s", "steady error m/s"], rows)


# ---------------------------------------------------------------------- picture


def picture(walk: Walks, mapped: list[dict[str, Any]], policies: int = 1) -> Figure:
    """Speeds through the schedule, of the first of policies; mean against commanded speed."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    parts = figure.subplots(1, 2, width_ratios=(2, 1)) if mapped else [figure.subplots()]
    time = (np.arange(len(walk.command)) + 1) * CASSIE.policy_period
    robot, model = walk.pelvis_velocity[:, 0, 0], walk.body_velocity[:, 0, 0]
    parts[0].plot(time, model, color="tab:blue", lw=1, label="reduced-order model")
    name = "robot's pelvis" if policies == 1 else f"robot's pelvis, first of {policies} policies"
    parts[0].plot(time, robot, color="tab:red", lw=1.2, label=name)
    smooth = stride_average(robot, 0.8, CASSIE.policy_period)
    parts[0].plot(time, smooth, color="tab:red", lw=3, alpha=0.3, label="mean of a stride")
    parts[0].step(time, walk.command[:, 0], "k--", where="pre", label="command")
    parts[0].set(xlabel="time [s]", ylabel="forward velocity [m/s]", xlim=(0, time[-1]))
    parts[0].legend(loc="upper right", fontsize=8)
    if mapped:
        commanded = [row["command"] for row in mapped]
        parts[1].plot(commanded, commanded, "k--", label="command")
        means = np.array([row["mean"] for row in mapped])
        spread = [means - [r["low"] for r in mapped], [r["high"] for r in mapped] - means]
        parts[1].errorbar(
            commanded, means, spread, fmt="o", color="tab:red", capsize=3, label="mean"
        )
        parts[1].set(xlabel="commanded speed [m/s]", ylabel="mean speed [m/s]")
        parts[1].legend()
    for part in parts:
        part.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
