"""Stops from a walk, standing, and starts: time, drift, turn, lifted feet, power and falls.

    python -m benchmarks.directions.stops --policy runs/ppo_directions
    python -m benchmarks.directions.stops --policy runs/seed0 runs/seed1 --walks 32

A robot walks at a command for some strides and a part of one, gets the stand command, stands for a
minute, and walks on at the same command. Commands are straight speeds, then random ones over the
region of the library; the parts of a stride are spread evenly, so that stand commands come at all
phases. Forces and torques are sampled at 2 kHz. The feet count as planted from the time at which
both carry a force for half a second; drift, turn, power and feet that lose the ground are measured
from 4 s after the stand command on, when the robot should have come to rest. A foot that is in the
air by then counts as lifted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import Directions, check_numbers


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5)
    """Forward speeds from which robots stop [m/s], moved into the region of the library."""
    walks: int = 12
    """Number of walks; those after the forward speeds have random commands."""
    duration: float = 60.0
    """Time of standing that is measured [s]."""
    before: float = 4.0
    """Time of walking before the stand command [s]."""
    rest: float = 4.0
    """Time from the stand command until the measurement [s]."""
    after: float = 4.0
    """Time of walking after standing [s]."""

    def __post_init__(self) -> None:
        """Check number of walks and duration."""
        super().__post_init__()
        check_numbers(self, "duration", walks=1, duration=0.5)
        if not all(map(math.isfinite, self.speeds)):
            raise ConfigurationError(f"speeds must be finite, got {self.speeds}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Sequence
from contextlib import closing
from typing import Any, Final

import numpy as np
import torch
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.walking import Substeps, record_substeps
from aslip.walking.metrics import drift, lifted_feet, mechanical_power, planting_time, turned
from benchmarks.common import Policies, Report, Subject, benchmark, table
from benchmarks.directions.random_commands import random_commands

_TICK: Final = CASSIE.physics_timestep
_TRACE = 0.05  # time between points of the picture [s]
STAGES = ("walk", "stop", "stand", "start")
"""Stages of a walk, in which a robot may fall."""

COLUMNS = {
    "policy": "{policy}",
    "walks": "{count}",
    f"falls: {', '.join(STAGES)}": lambda row: ", ".join(map(str, row["falls"].values())),
    "never planted": "{unplanted}",
    "planted after [s]": "{planted:.2f} ({planted_most:.2f})",
    "drift [cm]": lambda row: f"{100 * row['drift']:.1f} ({100 * row['drift_most']:.1f})",
    "turn [deg]": lambda row: (
        f"{math.degrees(row['turn']):.2f} ({math.degrees(row['turn_most']):.2f})"
    ),
    "feet lifted": "{lifted:.1f} ({lifted_most:.1f})",
    "power [W]": "{power:.0f} ({power_most:.0f})",
}
"""Means, and largest values in parentheses."""


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each policy."""
    subjects = policies.load("directions")
    chosen = commands(config, subjects[0].library)
    later = delays(subjects[0].library, chosen)
    walks = [*zip(seeds(config), chosen, later, strict=True)]
    rows, traces = [], []
    for subject in subjects:
        found = [
            measure(replace(config, seed=seed), subject, command, delay)
            for seed, command, delay in tqdm(walks, unit="walk", leave=False)
        ]
        traces.append([walk.pop("traces") for walk in found])
        rows.append({"policy": subject.name, **summary(found), "walks": found})
    return Report(rows, table(COLUMNS, rows), picture(rows[0]["walks"], traces[0]))


def commands(config: Config, library: GaitLibrary) -> np.ndarray:
    """Commands (n, 3) from which robots stop: straight ones, then random ones."""
    straight = np.zeros((len(config.speeds), library.command_size))
    straight[:, 0] = config.speeds
    nearest = library.nearest(torch.from_numpy(straight)).numpy()
    random = random_commands(library, max(config.walks - len(straight), 1), config.seed)
    return np.concatenate([nearest, random])[: config.walks]


def seeds(config: Config) -> list[int]:
    """Seeds of the walks, so that each has sensor noise of its own."""
    return np.random.SeedSequence(config.seed).generate_state(config.walks).tolist()


def delays(library: GaitLibrary, command: np.ndarray) -> np.ndarray:
    """Times (n,) [s] by which stand commands come later, from none to nearly a stride.

    Args:
        library: the gaits.
        command: (n, c) commands of the walks.
    """
    stride = library.stride(torch.from_numpy(command)).squeeze(-1).numpy()
    return stride * np.arange(len(command)) / len(command)


def measure(config: Config, subject: Subject, command: np.ndarray, delay: float) -> dict[str, Any]:
    """Measure one walk; quantities that a fall prevents are NaN.

    Args:
        config: the settings.
        subject: policy.
        command: (c,) command before and after standing.
        delay: time by which the stand command comes later [s].
    """
    torch.set_num_threads(1)
    lasts = (config.before + delay, config.rest, config.duration, config.after)
    steps = [round(time / CASSIE.policy_period) for time in lasts]
    ends = np.cumsum(steps)
    stand = np.zeros(ends[-1])
    stand[ends[0] : ends[2]] = 1.0
    with closing(subject.walking_env(config, 1, num_threads=1)) as env:
        walk = record_substeps(subject.policy, env, np.tile(command, (ends[-1], 1)), stand)
    return quantities(walk, command, ends * CASSIE.substeps)


def quantities(walk: Substeps, command: np.ndarray, ends: np.ndarray) -> dict[str, Any]:
    """Numbers of a walk whose stages end at the substeps `ends` (4)."""
    force = walk.ground_force[..., 2]
    fell = STAGES[int(np.searchsorted(ends, len(force)))] if walk.fell else None
    found: dict[str, Any] = {"command": command.tolist(), "fell": fell}
    found["planted"] = planting_time(force[ends[0] : ends[2]], _TICK)
    found |= dict.fromkeys(("drift", "turn", "lifted", "power"), math.nan) | {"traces": None}
    still = slice(ends[1], ends[2])
    if len(force) < ends[2]:
        return found
    away = drift(walk.pelvis_position[still])
    angle = turned(walk.pelvis_orientation[still])
    found["drift"], found["turn"] = float(away.max()), float(np.abs(angle).max())
    found["lifted"] = lifted_feet(force[still])
    found["power"] = mechanical_power(walk.motor_torque[still], walk.motor_velocity[still])
    every = round(_TRACE / _TICK)
    found["traces"] = away[::every], angle[::every]
    return found


def summary(walks: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Falls in each stage, and means and largest values of walks without a fall before.

    `unplanted` is the number of walks that stood to the end, without ever planting both feet.
    """
    row: dict[str, Any] = {"count": len(walks)}
    stood = [walk for walk in walks if walk["fell"] not in ("walk", "stop", "stand")]
    row["unplanted"] = sum(not math.isfinite(walk["planted"]) for walk in stood)
    row["falls"] = {stage: sum(walk["fell"] == stage for walk in walks) for stage in STAGES}
    for name in ("planted", "drift", "turn", "lifted", "power"):
        values = [walk[name] for walk in walks if math.isfinite(walk[name])]
        row[name] = float(np.mean(values)) if values else math.nan
        row[f"{name}_most"] = float(np.max(values)) if values else math.nan
    return row


def picture(walks: Sequence[dict[str, Any]], traces: Sequence[Any]) -> Figure:
    """Time to planted feet, power, drift and turn; a colour for each forward speed."""
    figure = Figure(figsize=(10, 7), layout="constrained")
    (planted, power), (away, angle) = figure.subplots(2, 2)
    speeds = np.array([walk["command"][0] for walk in walks])
    scale = ScalarMappable(Normalize(speeds.min(), speeds.max()), "viridis")
    for walk, trace in zip(walks, traces, strict=True):
        colour = scale.to_rgba(walk["command"][0])
        planted.plot(walk["command"][0], walk["planted"], "o", color=colour, ms=5)
        power.plot(walk["command"][0], walk["power"], "o", color=colour, ms=5)
        if trace is not None:
            time = np.arange(len(trace[0])) * _TRACE
            away.plot(time, 100 * trace[0], color=colour, lw=1)
            angle.plot(time, np.degrees(trace[1]), color=colour, lw=1)
    speed = "forward speed before the stop [m/s]"
    planted.set(xlabel=speed, ylabel="time to planted feet [s]")
    power.set(xlabel=speed, ylabel="power in standing [W]")
    for axes in (planted, power):
        # a margin above the points, also if they differ little
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])
    away.set(xlabel="time in standing [s]", ylabel="drift of the pelvis [cm]")
    angle.set(xlabel="time in standing [s]", ylabel="turn of the pelvis [deg]")
    for axes in (planted, power, away, angle):
        axes.grid(alpha=0.3)
    falls = sum(walk["fell"] is not None for walk in walks)
    figure.suptitle(f"{falls} falls in {len(walks)} walks")
    figure.colorbar(scale, ax=[away, angle], label=speed, location="bottom", aspect=60)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
