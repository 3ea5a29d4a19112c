"""Loss of ground contact, slip, impacts and power of walks over commanded speed.

    python -m benchmarks.robustness.walking_quality  # the shipped policies
    python -m benchmarks.robustness.walking_quality --policy mine=runs/mine-{1,2} p=runs/p-1

Each policy is a method of its own; `name=` before several policies makes them seeds of one method.
Forces, torques and positions of the settled walk are sampled at 2 kHz. Definitions and
their sources are in `aslip.walking.metrics`: `airborne_share`, `longest_airborne`, `slip_distance`,
`touchdown_impact`, `largest_force`, `friction_limit_share`, `mechanical_power` and
`cost_of_transport`.

The spring-mass model nearly unloads its legs in mid-stance, so robot and model are also compared by
the share of time in which each foot carries less than 20 N.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import WithLibrary


@dataclass(frozen=True)
class Config(WithLibrary):
    """Settings of the benchmark."""

    policy: tuple[str, ...] = ("straight", "robust", "single_reference")
    """Policies to measure: names, files or run folders. `method=policy` names its method; policies
    of one method count as its seeds."""
    speeds: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0)
    """Commanded speeds [m/s]."""
    settle: float = 4.0
    """Time at the start that is not measured [s]."""
    walk: float = 8.0
    """Duration of the measurement [s]."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any, Final

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.base.interval import Interval
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.show.palette import SERIES
from aslip.walking import Substeps, record_substeps
from aslip.walking.metrics import (
    airborne_share,
    cost_of_transport,
    friction_limit_share,
    largest_force,
    longest_airborne,
    mechanical_power,
    slip_distance,
    touchdown_impact,
)
from aslip.walking.metrics.contact import CONTACT_FORCE
from benchmarks.common import (
    Policies,
    Report,
    Subject,
    benchmark,
    nearest_motion,
    shortest_swing,
    table,
)
from benchmarks.paper.ground_force import model_force

_FRICTION = 1.0  # of the model's floor
_MODEL = "spring-mass model"


@dataclass(frozen=True)
class Quantity:
    """Measured quantity, and its display in the report."""

    column: str
    """Name and unit in the table."""
    digits: int
    """Digits after the decimal point."""
    scale: float = 1.0
    """Shown value over the value in SI units."""
    panel: str = ""
    """Label in the figure; empty without a panel of its own."""


QUANTITIES: Final[Mapping[str, Quantity]] = {
    "airborne": Quantity("no contact [%]", 1, 100, "time without ground contact [%]"),
    "longest": Quantity("longest [ms]", 0, 1e3),
    "unloaded": Quantity("both feet below 20 N [%]", 1, 100),
    "slip": Quantity("slip per stance [cm]", 1, 100, "slip of the sole per stance [cm]"),
    "impact": Quantity("impact / weight", 2, 1, "impact at touchdown / weight"),
    "largest": Quantity("largest force / weight", 2, 1, "largest force of a foot / weight"),
    "friction": Quantity("at the limit of friction [%]", 2, 100),
    "power": Quantity("power [W]", 0, 1, "positive mechanical power [W]"),
    "cost": Quantity("cost of transport", 2, 1, "mechanical cost of transport"),
}
"""Quantities of a walk, by name."""

# panel -> quantity of the model that is drawn there, its colour and label
_MODEL_LINES: Final = {
    "airborne": ("unloaded", "black", "model: both legs below 20 N"),
    "largest": ("largest", "0.5", "model: largest force"),
}


COLUMNS = {
    "method": "{method}",
    "command [m/s]": lambda row: str(round(row["speed"], 3)),
    **{
        one.column: lambda row, name=name, one=one: (
            Interval.of_row(row[name]).text(one.digits, one.scale)
            if np.isfinite(row[name]["mean"])
            else ""
        )
        for name, one in QUANTITIES.items()
    },
    "survived": lambda row: f"{row['walked']} of {row['seeds']}" if row["seeds"] else "",
}


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each method and speed."""
    methods = policies.methods()
    library = next(iter(methods.values()))[0].library
    footholds = Footholds(library)
    runs = [(name, one, v) for name, ones in methods.items() for v in config.speeds for one in ones]
    found: dict[tuple[str, float], list[dict[str, float] | None]] = {}
    for name, subject, speed in tqdm(runs, unit="walk", leave=False):
        found.setdefault((name, speed), []).append(measure(config, footholds, subject, speed))
    rows = [summary(name, speed, seeds) for (name, speed), seeds in found.items()]
    # libraries over three commands keep tables, not gaits with leg forces
    modelled = library.command_size == 1 and bool(library.motions)
    figure = picture(
        rows, model_rows(library, gaits_between(library, config.speeds)) if modelled else []
    )
    rows += model_rows(library, config.speeds) if modelled else []
    return Report(rows, table(COLUMNS, rows), figure)


# ---------------------------------------------------------------------- measurement


def measure(
    config: Config, footholds: Footholds, subject: Subject, speed: float
) -> dict[str, float] | None:
    """Measure a subject's settled walk at one speed; None after a fall."""
    torch.set_num_threads(1)
    steps = round((config.settle + config.walk) / CASSIE.policy_period)
    with closing(subject.walking_env(config, 1, num_threads=1)) as env:
        walk = record_substeps(subject.policy, env, np.full(steps, speed))
        weight = float(env.base_env.weight[0])
    if walk.fell:
        return None
    return quantities(walk.since(config.settle), weight, speed, shortest_swing(footholds, speed))


def quantities(walk: Substeps, weight: float, command: float, swing: float) -> dict[str, float]:
    """Compute the `QUANTITIES` of a walk.

    Args:
        walk: the walk.
        weight: weight of the robot [N].
        command: commanded speed [m/s]; at 0 there is no cost of transport.
        swing: shortest swing [s].
    """
    period, force = CASSIE.physics_timestep, walk.ground_force[..., 2]
    feet = range(force.shape[1])
    slips = [slip_distance(force[:, i], walk.foot_position[:, i], period, swing) for i in feet]
    impacts = [touchdown_impact(force[:, i], period, weight, swing) for i in feet]
    power = mechanical_power(walk.motor_torque, walk.motor_velocity)
    covered = walk.pelvis_position[-1, :2] - walk.pelvis_position[0, :2]
    speed = float(np.linalg.norm(covered)) / (period * (len(force) - 1))
    return {
        "airborne": airborne_share(force),
        "longest": longest_airborne(force, period),
        "unloaded": airborne_share(force, CONTACT_FORCE),
        "slip": float(np.mean(slips)),
        "impact": float(np.mean(impacts)),
        "largest": largest_force(force, weight),
        "friction": friction_limit_share(walk.ground_force, _FRICTION),
        "power": power,
        "cost": cost_of_transport(power, weight, speed) if command else float("nan"),
    }


def summary(method: str, speed: float, seeds: Sequence[dict[str, float] | None]) -> dict[str, Any]:
    """Row of a method at one speed: means over the seeds that did not fall, with intervals."""
    walked = [one for one in seeds if one is not None]
    means = {
        name: vars(Interval.of([np.array([one[name]]) for one in walked])) for name in QUANTITIES
    }
    counts = {"walked": len(walked), "seeds": len(seeds)}
    return {"method": method, "speed": speed, **counts, **means}


def model_rows(library: GaitLibrary, speeds: Sequence[float]) -> list[dict[str, Any]]:
    """Rows of the model: time with forces below 20 N, and largest force."""
    rows = []
    for speed in speeds:
        left = model_force(nearest_motion(library, speed))
        # gaits are mirror symmetric: the right leg repeats the left half a stride later
        force = np.stack([left, np.roll(left, len(left) // 2)], axis=1)
        values = {
            **dict.fromkeys(QUANTITIES, float("nan")),
            "unloaded": airborne_share(force, CONTACT_FORCE),
            "largest": largest_force(force, CASSIE.total_mass * STANDARD_GRAVITY),
        }
        rows.append({**summary(_MODEL, speed, [values]), "walked": 0, "seeds": 0})
    return rows


def gaits_between(library: GaitLibrary, speeds: Sequence[float]) -> list[float]:
    """Speeds of the library's gaits from the lowest to the highest of speeds [m/s]."""
    return [speed for speed in library.speeds.tolist() if min(speeds) <= speed <= max(speeds)]


# --------------------------------------------------------------------------- report


def picture(rows: Sequence[Mapping[str, Any]], model: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw quantities over commanded speed, a line for each method.

    Args:
        rows: rows of the methods.
        model: rows of the model, dashed; may be empty.
    """
    panels = {name: quantity for name, quantity in QUANTITIES.items() if quantity.panel}
    figure = Figure(figsize=(11, 6), layout="constrained")
    grid = figure.subplots(2, len(panels) // 2, sharex=True)
    methods = dict.fromkeys(row["method"] for row in rows)
    for axis, (name, quantity) in zip(grid.flat, panels.items(), strict=True):
        axis.set_prop_cycle(color=SERIES)
        for method, marker in zip(methods, itertools.cycle("os^Dv<>P")):
            _draw(axis, [row for row in rows if row["method"] == method], name, marker)
        if model and name in _MODEL_LINES:
            shown, color, label = _MODEL_LINES[name]
            value = [quantity.scale * row[shown]["mean"] for row in model]
            axis.plot([row["speed"] for row in model], value, "--", color=color, label=label)
        axis.set_title(quantity.panel, fontsize=10)
        axis.set_ylim(0, None)
        axis.grid(alpha=0.3)
    for axis in grid[-1]:
        axis.set_xlabel("commanded speed [m/s]")
    labelled = [zip(*axis.get_legend_handles_labels(), strict=True) for axis in grid.flat]
    handles = {label: line for pairs in labelled for line, label in pairs}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=9)
    return figure


def _draw(axis: Axes, rows: Sequence[Mapping[str, Any]], name: str, marker: str) -> None:
    """Draw one method's quantity, with a band for the interval over seeds."""
    scale, seeds = QUANTITIES[name].scale, max(row["seeds"] for row in rows)
    speeds = [row["speed"] for row in rows]
    mean, low, high = (
        scale * np.array([row[name][key] for row in rows]) for key in ("mean", "low", "high")
    )
    label = f"{rows[0]['method']} ({'one seed' if seeds == 1 else f'{seeds} seeds'})"
    (line,) = axis.plot(speeds, mean, marker=marker, ms=4, label=label)
    if seeds > 1:
        axis.fill_between(speeds, low, high, color=line.get_color(), alpha=0.2, lw=0)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
