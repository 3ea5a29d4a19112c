"""Velocity tracking: through a schedule, at constant speeds, and after step changes.

    python -m benchmarks.paper.velocity_tracking                  # the policy `straight`
    python -m benchmarks.paper.velocity_tracking --policy runs/seed0 runs/seed1 runs/seed2

The schedule is the paper's: 0, 0.8, 1.9, 0.4, 1.3, 0.5 m/s; for a library of slower gaits it is
scaled to their range. A map compares mean and commanded speed. A table lists the responses to
steps of 1 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import WithLibrary


@dataclass(frozen=True)
class Config(WithLibrary):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = tuple(i / 10 for i in range(21))
    """Commanded speeds of the map [m/s]."""
    hold: float = 4.0
    """Time for which the schedule, and each side of a step, holds a command [s]."""
    transient: float = 1.5
    """Time after a change of the command that means over the schedule exclude [s]."""
    settle: float = 4.0
    """Time at the start of a walk that the map leaves out [s]."""
    walk: float = 8.0
    """Duration of the measurement for the map [s]."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.library import PAPER_SPEEDS, GaitLibrary
from aslip.library.footholds import Footholds
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.show.palette import MODEL, ROBOT
from aslip.walking import TRACKING_TOLERANCE, Walks, is_on_feet, tracks_command
from aslip.walking.metrics import (
    StepResponse,
    root_mean_square,
    stances,
    step_response,
    stride_average,
    touchdown_spike,
)
from benchmarks.common import (
    Policies,
    Report,
    Subject,
    benchmark,
    constant_walks,
    record_subject,
    table,
)

SCHEDULE: Final = (0.0, 0.8, 1.9, 0.4, 1.3, 0.5)
"""Commanded speeds of the schedule [m/s]."""

STEPS: Final = ((0.0, 1.0), (1.0, 2.0), (0.5, 1.5), (1.5, 0.5), (2.0, 1.0), (1.0, 0.0))
"""Step changes of the command, from and to [m/s]."""

PUBLISHED: Final = MappingProxyType(
    {0.0: -0.005, 0.4: 0.397, 0.5: 0.484, 0.8: 0.778, 1.3: 1.278, 1.9: 1.898}
)
"""Commanded -> mean speed [m/s] in the authors' recording, 1.5 s after each change."""

# weight of the nominal robot [N]
_WEIGHT = CASSIE.total_mass * STANDARD_GRAVITY
# half-width of the model's velocity spike at touchdown [policy steps]
_SPIKE = 2

SCHEDULE_COLUMNS = {
    "command [m/s]": "{command:.3f}",
    "robot [m/s]": "{robot:.3f}",
    "oscillation [m/s]": "{robot_std:.3f}",
    "model [m/s]": "{model:.3f}",
    "RMS difference to model [m/s]": "{rms:.3f}",
    "published [m/s]": lambda row: (
        f"{row['published']:.3f}" if math.isfinite(row["published"]) else ""
    ),
}

MAP_COLUMNS = {
    "command [m/s]": "{command:.1f}",
    "mean [m/s]": "{mean:.3f}",
    "error [m/s]": lambda row: f"{row['mean'] - row['command']:+.3f}",
    "lateral [m/s]": "{sideways:.3f}",
    **{
        header: lambda row, name=name: f"{sum(row[name])} of {len(row[name])}"
        for header, name in {
            "survived": "survived",
            "on the feet": "on_feet",
            f"tracked within {TRACKING_TOLERANCE:g} m/s": "tracked",
        }.items()
    },
}

STEP_COLUMNS = {
    "step [m/s]": "{from:.1f} to {to:.1f}",
    "settling time [s]": lambda row: (
        f"{row['settling']:.2f}" if math.isfinite(row["settling"]) else "never"
    ),
    "overshoot [m/s]": "{overshoot:.2f}",
    "steady error [m/s]": "{steady_error:+.3f}",
}


@benchmark
def main(config: Config, policies: Policies) -> Report[dict[str, Any]]:
    """Measure and draw; the result is the numbers."""
    subjects = policies.load()
    speeds = reachable(subjects[0].library, SCHEDULE)
    command = np.repeat(speeds, round(config.hold / CASSIE.policy_period))[:, None]
    walks = [record_subject(config, subject, command) for subject in subjects]
    numbers = {
        "schedule": schedule_rows(config, walks),
        "map": map_rows(config, subjects),
        "steps": step_rows(config, subjects, Footholds(subjects[0].library)),
        "spike": spike_numbers(walks),
    }
    columns = {"schedule": SCHEDULE_COLUMNS, "map": MAP_COLUMNS, "steps": STEP_COLUMNS}
    text = "\n\n".join(table(of, numbers[name]) for name, of in columns.items())
    return Report(numbers, text, picture(walks[0], numbers["map"], len(walks)), numbers)


def reachable(library: GaitLibrary, speeds: Sequence[Any]) -> np.ndarray:
    """Speeds of the paper, 0 to 2 m/s, scaled to the range of a library of slower gaits."""
    fastest = PAPER_SPEEDS[-1]
    low, high = max(0.0, library.speeds[0]), min(fastest, library.speeds[-1])
    return low + np.array(speeds) * (high - low) / fastest


# --------------------------------------------------------------------- schedule


def schedule_rows(config: Config, walks: list[Walks]) -> list[dict[str, float]]:
    """Mean speeds of robot and model in each part of a schedule, without the transient."""
    command = walks[0].speed[:, 0]
    bounds = [0, *np.flatnonzero(np.diff(command)) + 1, len(command)]
    rows = []
    for start, stop in itertools.pairwise(bounds):
        steady = slice(min(start + round(config.transient / CASSIE.policy_period), stop - 1), stop)
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


def spike_numbers(walks: list[Walks]) -> dict[str, Any]:
    """Mean range of speed around the model's touchdowns over walks, robot and model [m/s]."""
    each = [walk_spikes(walk) for walk in walks]
    return {name: float(np.mean([one[name] for one in each])) for name in ("robot", "model")}


def walk_spikes(walk: Walks) -> dict[str, float]:
    """Mean range of speed around the model's touchdowns of one walk; NaN after a fall [m/s]."""
    if not walk.survived.all():
        return {"robot": math.nan, "model": math.nan}
    # the model's foot is in stance where its height is zero
    height = walk.body_position[:, :1, 2] + walk.body_to_foot[:, 0, :, 2]
    model, robot = walk.body_velocity[:, 0, 0], walk.pelvis_velocity[:, 0, 0]
    down = [stances(np.where(h < 1e-3, 100.0, 0.0), CASSIE.policy_period)[:, 0] for h in height.T]
    return {
        name: float(np.nanmean([touchdown_spike(speed, samples, _SPIKE) for samples in down]))
        for name, speed in (("robot", robot), ("model", model))
    }


# -------------------------------------------------------------------------- map


def map_rows(config: Config, subjects: list[Subject]) -> list[dict[str, Any]]:
    """Mean speed at each command, and whether policies survived, on their feet, and tracked it."""
    walks = constant_walks(config, subjects, config.speeds, config.settle + config.walk)
    first = round(config.settle / CASSIE.policy_period)
    rows = []
    for i, speed in enumerate(config.speeds):
        means = np.array([mean_velocity(walk.pelvis_place[first:, i]) for walk in walks])
        each = means[:, 0].tolist()
        drift = np.abs(means[:, 1]).mean()
        carried = [walk.ground_force[first:, i, :, 2].sum(1).mean() / _WEIGHT for walk in walks]
        rows.append(
            {
                "command": speed,
                **vars(Interval.of([np.array([mean]) for mean in each])),
                "sideways": float(drift),
                "survived": [bool(walk.survived[i]) for walk in walks],
                # false for NaN after a fall
                "on_feet": [bool(is_on_feet(ratio, config.walk)) for ratio in carried],
                "tracked": [bool(tracks_command(speed, mean)) for mean in each],
            }
        )
    return rows


def mean_velocity(position: np.ndarray) -> np.ndarray:
    """Mean velocity (2,) from positions (m, 2) at the ends of policy steps [m/s]."""
    return (position[-1] - position[0]) / ((len(position) - 1) * CASSIE.policy_period)


# ------------------------------------------------------------------------ steps


def step_rows(
    config: Config, subjects: list[Subject], footholds: Footholds
) -> list[dict[str, Any]]:
    """Responses to sudden changes of command, a row for each change."""
    hold = round(config.hold / CASSIE.policy_period)
    steps = reachable(subjects[0].library, STEPS)
    command = np.repeat(steps.T, hold, axis=0)
    walks = [record_subject(config, subject, command) for subject in subjects]
    rows = []
    for i, (old, new) in enumerate(steps.tolist()):
        responses = [walk_step_response(walk, i, hold, footholds) for walk in walks]
        rows.append(
            {
                "from": old,
                "to": new,
                "settling": float(np.mean([r.settling_time for r in responses])),
                "overshoot": float(np.mean([r.overshoot for r in responses])),
                "steady_error": float(np.mean([r.steady_error for r in responses])),
            }
        )
    return rows


def walk_step_response(walk: Walks, index: int, change: int, footholds: Footholds) -> StepResponse:
    """Response of one walk to the change at a policy step; a fall never settles."""
    old, new = walk.speed[change - 1, index], walk.speed[change, index]
    if not walk.survived[index]:
        return StepResponse(math.inf, math.nan, math.nan)
    speed = walk.pelvis_velocity[change:, index, 0]
    return step_response(speed, old, new, footholds.stride(new), CASSIE.policy_period)


# ---------------------------------------------------------------------- picture


def picture(walk: Walks, mapped: list[dict[str, Any]], policies: int = 1) -> Figure:
    """Speed of the first policy through the schedule; mean over commanded speed of all."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    parts = figure.subplots(1, 2, width_ratios=(2, 1))
    time = (np.arange(len(walk.command)) + 1) * CASSIE.policy_period
    robot, model = walk.pelvis_velocity[:, 0, 0], walk.body_velocity[:, 0, 0]
    parts[0].plot(time, model, color=MODEL, lw=1, label="reduced-order model")
    name = "robot's pelvis" if policies == 1 else f"robot's pelvis, first of {policies} policies"
    parts[0].plot(time, robot, color=ROBOT, lw=1.2, label=name)
    smooth = stride_average(robot, 0.8, CASSIE.policy_period)
    parts[0].plot(time, smooth, color=ROBOT, lw=3, alpha=0.3, label="stride average")
    parts[0].step(time, walk.speed[:, 0], "k--", where="pre", label="command")
    parts[0].set(xlabel="time [s]", ylabel="forward velocity [m/s]", xlim=(0, time[-1]))
    parts[0].legend(loc="upper right", fontsize=8)
    commanded = [row["command"] for row in mapped]
    parts[1].plot(commanded, commanded, "k--", label="command")
    means = np.array([row["mean"] for row in mapped])
    spread = [means - [r["low"] for r in mapped], [r["high"] for r in mapped] - means]
    parts[1].errorbar(commanded, means, spread, fmt="o", color=ROBOT, capsize=3, label="mean")
    parts[1].set(xlabel="commanded speed [m/s]", ylabel="mean speed [m/s]")
    parts[1].legend()
    for part in parts:
        part.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
