"""Values of the targets of walks in all directions, from numbers of other benchmarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aslip.base.interval import Interval
from aslip.library.footholds import Footholds
from aslip.policy import read_card
from aslip.robot import CASSIE
from benchmarks.common import MakeEnv, Policies, Policy, record_subject
from benchmarks.directions import command_changes, figure_of_eight, stops, tracking
from benchmarks.directions.random_commands import random_commands
from benchmarks.paper import foot_placement
from benchmarks.robustness import pushes, walking_quality
from benchmarks.scorecard.direction_list import SWEPT

SPEEDS: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Speeds of the straight walks [m/s]."""

_ONE, _TWO = 2, 4  # places of 1 and 2 m/s


def measure(
    settings: Mapping[str, Any], policy: Policy, make_env: MakeEnv | None = None
) -> dict[str, float | Interval]:
    """Value of each target for one policy; NaN where falls leave nothing to measure.

    Intervals are over commands or walks.

    Falls at random commands, in changes and in stops have targets of their own, and the other
    values are over the walks without a fall. The largest values of straight walks, and forces, are
    NaN after any fall in these.

    Args:
        settings: settings of each benchmark, by its name.
        policy: the policy.
        make_env: function that makes the environment; by default the one that the policy's card
            names.
    """
    of = (policy, make_env)
    (errors,) = tracking.main(settings["tracking"], *of)
    (changed,) = command_changes.main(settings["changes"], *of)
    (stood,) = stops.main(settings["standing"], *of)
    (stopped,) = stops.main(settings["stops"], *of)
    (walked,) = figure_of_eight.main(settings["path"], *of)
    quality = walking_quality.main(settings["quality"], *of)
    survived = pushes.main(settings["pushes"], *of)
    falls, changes = len(changed["falls"]), changed["changes"]
    return {
        **training_values(policy),
        "falls, walks": Interval.of_share(errors["falls"], errors["count"]).scaled(1e3),
        "velocity": Interval.of_row(errors["speed"]),
        "velocity, 95 %": Interval.of_row(errors["speed_p95"]),
        "yaw rate": Interval.of_row(errors["turn"]),
        "yaw rate, 95 %": Interval.of_row(errors["turn_p95"]),
        "falls, changes": Interval.of_share(falls, changes).scaled(1e4),
        **standing_values(stood, stopped),
        **foot_values(settings, *of),
        **quality_values(quality),
        **push_values(survived),
        "path": math.nan if walked["fell"] else 100 * walked["truth"],
    }


def training_values(policy: Policy) -> dict[str, float]:
    """Cost of the training, from the policy's file; NaN for a module."""
    made = read_card(policy).get("made_by", {}) if isinstance(policy, str | Path) else {}
    return {
        "samples": made.get("steps", math.nan) / 1e6,
        "time": made.get("seconds", math.nan) / 60,
    }


def standing_values(
    row: Mapping[str, Any], stopped: Mapping[str, Any]
) -> dict[str, float | Interval]:
    """Values of stops and of standing; NaN if no robot stood to the end.

    Args:
        row: result of `benchmarks.directions.stops` for walks that stop, stand and start.
        stopped: the same for the stops at 1 m/s, whose falls count, too.
    """
    lifted = [walk["lifted"] for walk in row["walks"] if math.isfinite(walk["lifted"])]
    count = row["count"] + stopped["count"]
    falls = [*row["falls"].values(), *stopped["falls"].values()]
    return {
        "falls, stops": Interval.of_share(sum(falls), count).scaled(100),
        "unplanted": Interval.of_share(row["unplanted"] + stopped["unplanted"], count).scaled(100),
        "stop": stopped["planted"],
        "drift": 100 * row["drift_most"],
        "turn": math.degrees(row["turn_most"]),
        "lifted feet": float(sum(lifted)) if lifted else math.nan,
        "power, standing": row["power"],
    }


def foot_values(
    settings: Mapping[str, Any], policy: Policy, make_env: MakeEnv | None
) -> dict[str, float | Interval]:
    """Foot placement errors of straight walks, and of walks at random commands [cm]."""
    placed = foot_placement.main(settings["straight"], policy, make_env)
    straight = [_mean(one.error) for ones in placed.values() for one in ones]
    config, count = settings["turns"]
    (subject,) = Policies(config, policy, make_env).load()
    command = random_commands(subject.library, count, config.seed)
    steps = round((config.settle + config.walk) / CASSIE.policy_period)
    walks = record_subject(config, subject, np.tile(command, (steps, 1, 1)))
    footholds = Footholds(subject.library)
    turns = np.array(
        [
            _mean(foot_placement.walk_placement(config, walks, i, tuple(one), footholds).error)
            for i, one in enumerate(command.tolist())
        ]
    )
    none = int((~np.isfinite(turns)).sum())
    return {
        "feet, straight": 100 * float(np.max(straight)),
        "feet, turns": Interval.of([turns]).scaled(100),
        "no footsteps": Interval.of_share(none, len(turns)).scaled(100),
    }


def _mean(error: np.ndarray) -> float:
    """Mean of a walk's errors; NaN after a fall, or without footsteps."""
    return float(error.mean()) if len(error) else math.nan


def quality_values(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Values of `benchmarks.robustness.walking_quality` at five speeds."""
    of = {name: [row[name]["mean"] for row in rows] for name in walking_quality.QUANTITIES}
    return {
        "no contact": 100 * float(np.max(of["airborne"])),
        "force": float(np.max([of["largest"][_ONE], of["largest"][_TWO]])),
        "slip": 100 * float(np.max(of["friction"])),
        "power, 1 m/s": of["cost"][_ONE],
        "power, 2 m/s": of["cost"][_TWO],
    }


def push_values(numbers: Mapping[str, Any]) -> dict[str, float | Interval]:
    """Values of `benchmarks.robustness.pushes`."""
    found: dict[str, float | Interval] = {**impulse_values(numbers["pushes"])}
    for name, (parameter, low, high) in SWEPT.items():
        rows = [
            row
            for row in numbers["sweeps"]
            if row["parameter"] == parameter and low <= row["value"] <= high
        ]
        survived = sum(round(row["trials"] * row["mean"]) for row in rows)
        share = Interval.of_share(survived, sum(row["trials"] for row in rows))
        found[name] = share.scaled(100)
    return found


def impulse_values(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Least and mean impulse [N s] of rows of directions, over these and their phases."""
    impulses = [cell["mean"] for row in rows for cell in row["phases"]]
    return {"pushes, least": float(np.min(impulses)), "pushes, mean": float(np.mean(impulses))}
