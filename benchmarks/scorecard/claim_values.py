"""Values of claims, one for each seed, from run folders and numbers of other benchmarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aslip.robot import CASSIE
from aslip.training.progress import read_progress
from aslip.walking import Walks
from aslip.walking.metrics import Placement, leg_length_correlation
from benchmarks.common import WALKING_LENGTH, Policy
from benchmarks.paper.ground_force import METHODS

Values = Mapping[str, Sequence[float]]
"""Name of a claim -> its value for each seed; not finite after a fall or if never reached."""

SPEEDS: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Speeds of the walks that are compared with the model's motion [m/s]."""

CONVERGED: Final = 300.0
"""Mean return of training episodes that the paper's training converges to, almost."""

_ROUNDING = 1e-6


def largest_by_seed(values: Sequence[Sequence[float]]) -> list[float]:
    """Largest value of each seed, from (conditions, seeds)."""
    return np.max(values, axis=0).tolist()


def smallest_by_seed(values: Sequence[Sequence[float]]) -> list[float]:
    """Smallest value of each seed, from (conditions, seeds)."""
    return np.min(values, axis=0).tolist()


def training_costs(policies: Sequence[Policy]) -> Values:
    """Samples, time and returns of trainings; none unless all policies are run folders."""
    folders = [Path(one) for one in policies if isinstance(one, str | Path) and Path(one).is_dir()]
    histories = [history for folder in folders if (history := read_progress(folder))]
    if not histories or len(histories) < len(policies):
        return {}
    costs = [_training_cost(history) for history in histories]
    return {name: [cost[name] for cost in costs] for name in costs[0]}


def _training_cost(history: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Costs of one training; infinite if its episodes never got there."""
    returns = np.array(history["episode_return"])
    walking = np.flatnonzero(np.array(history["episode_length"]) >= WALKING_LENGTH)
    converged = np.flatnonzero(returns >= CONVERGED)
    evaluated = np.array(history["eval_return"])
    return {
        "samples": history["step"][walking[0]] / 1e6 if len(walking) else math.inf,
        "return": float(returns[-1]),
        "training time": (
            history["elapsed_s"][converged[0]] / 3600 if len(converged) else math.inf
        ),
        "evaluation return": [math.nan, *evaluated[np.isfinite(evaluated)].tolist()][-1],
    }


def speed_claims(numbers: dict[str, Any]) -> Values:
    """Values of claims on speed, from the numbers of `velocity_tracking`."""
    rows = numbers["map"]
    off = [[abs(mean - row["command"]) for mean in row["each"]] for row in rows]
    settling = [row["each"]["settling"] for row in numbers["steps"]]
    return {
        "all speeds": np.sum([_all_held(row) for row in rows], axis=0).tolist(),
        "velocity tracking": largest_by_seed(off),
        "smooth transitions": np.isfinite(settling).sum(axis=0).tolist(),
        "settling": largest_by_seed(settling),
        "touchdown spikes": spike_ratios(numbers),
    }


def spike_ratios(numbers: dict[str, Any]) -> list[float]:
    """Range of speed around touchdowns of each seed, robot over model; NaN after a fall."""
    return [one["robot"] / one["model"] for one in numbers["spike"]["each"]]


def _all_held(row: dict[str, Any]) -> np.ndarray:
    """(seeds,) whether the walk survived on its feet and tracked its command."""
    return np.all([row[key] for key in ("survived", "on_feet", "tracked")], axis=0)


def foot_claims(placements: Mapping[float, Sequence[Placement]]) -> Values:
    """Values of claims on foot placement [cm]."""
    error = {speed: _means([p.error for p in ps]) for speed, ps in placements.items()}
    forward = {v: _means([p.offset[:, 0] for p in placements[v]]) for v in (1.0, 2.0)}
    outward = [_means([p.outward for p in ps]) for ps in placements.values()]
    below = [error[speed] for speed in placements if speed < 1.0 - _ROUNDING]
    return {
        "wider feet": smallest_by_seed(outward),
        "feet below 1 m/s": largest_by_seed(below),
        "feet lag": np.subtract(forward[2.0], forward[1.0]).tolist(),
        "feet to 1.0 m/s": largest_by_seed([*below, error[1.0]]),
        "feet at 1.5 m/s": error[1.5],
        "feet at 2.0 m/s": error[2.0],
    }


def _means(lengths: Sequence[np.ndarray]) -> list[float]:
    """Mean of each seed's lengths [cm]; NaN without any."""
    return [100 * float(length.mean()) if len(length) else math.nan for length in lengths]


def force_claims(rows: Sequence[Mapping[str, Any]]) -> dict[str, Values]:
    """Kind of policies -> values of claims on ground forces, from the rows of `ground_reaction`."""

    def ratios(kind: str, speed: float) -> list[float]:
        found = [r for r in rows if (r["method"], r["speed"]) == (METHODS[kind], speed)]
        return [r.get("dip_ratio", math.nan) for r in found]

    values: dict[str, Values] = {}
    for kind in ("policy", "paper"):
        if ratios(kind, 0.0):
            values[kind] = {"double hump": largest_by_seed([ratios(kind, v) for v in (0.0, 1.0)])}
    if ratios("baseline", 0.0):
        theirs = [ratios("baseline", speed) for speed in (0.0, 1.0, 2.0)]
        values["baseline"] = {"baseline's single hump": smallest_by_seed(theirs)}
    return values


def correlation_claims(walks: Sequence[Walks], settle: float) -> Values:
    """Values of claims on similarity to the model: mean correlations over speeds.

    Args:
        walks: walks at `SPEEDS`, one for each seed.
        settle: duration at their beginning that is left out [s].
    """
    first = round(settle / CASSIE.policy_period)
    speed, legs = [], []
    for walk in walks:
        if not walk.survived.all():
            speed.append(math.nan)
            legs.append(math.nan)
            continue
        ones = [walk.one(i, first) for i in range(len(SPEEDS))]
        # in place, the model's velocity does not oscillate
        moving = [w for w in ones if w.command[0, 0] > 0]
        speed.append(np.mean([_speed_correlation(w) for w in moving]))
        legs.append(np.mean([_leg_correlation(w) for w in ones]))
    return {"velocity oscillation": speed, "springy legs": legs}


def _speed_correlation(walk: Walks) -> float:
    robot, model = walk.pelvis_velocity[:, 0, 0], walk.body_velocity[:, 0, 0]
    return float(np.corrcoef(robot, model)[0, 1])


def _leg_correlation(walk: Walks) -> float:
    robot = np.linalg.norm(walk.foot_position - walk.pelvis_position[:, :, None], axis=-1)
    model = np.linalg.norm(walk.body_to_foot, axis=-1)
    return leg_length_correlation(robot[:, 0], model[:, 0])
