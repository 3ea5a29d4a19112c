"""Values of the paper's claims for one policy, from its run folder and other benchmarks."""

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
from benchmarks.common import MakeEnv, Policies, Policy, constant_walks, policy_name
from benchmarks.flags import Common
from benchmarks.paper import foot_placement, ground_force, step_frequency, velocity_tracking
from benchmarks.scorecard.learning_record import WALKING_LENGTH
from benchmarks.scorecard.record import describe

SPEEDS: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Speeds of the walks that are compared with the model's motion [m/s]."""

CONVERGED: Final = 300.0
"""Mean return of training episodes that the paper's training converges to, almost."""

_ROUNDING = 1e-6


def measure(
    config: Common, kind: str, policy: Policy, make_env: MakeEnv | None = None
) -> dict[str, float]:
    """Value of each claim about a kind of policies, for one of them.

    Values are NaN after a fall, and infinite for what never happened. Pictures and tables of the
    benchmarks are written to a folder of the policy.
    """
    common: dict[str, Any] = {"policy": (policy_name(policy),), "truth": config.truth}
    common |= {"seed": config.seed, "out": config.out / describe(policy)["name"]}
    of = (policy, make_env)
    forces = ground_force.main(ground_force.Config(**common), *of)
    if kind == "baseline":
        return {"baseline's single hump": float(np.min(dip_ratios(forces)))}
    settings = foot_placement.Config(**common)
    duration = settings.settle + ground_force.Config().walk
    subjects = Policies(settings, *of).load()
    (walks,) = constant_walks(settings, subjects, SPEEDS, duration)
    frequencies = step_frequency.main(step_frequency.Config(**common), *of)
    return {
        **training_costs(policy),
        **speed_values(velocity_tracking.main(velocity_tracking.Config(**common), *of)),
        **foot_values({v: ones[0] for v, ones in foot_placement.main(settings, *of).items()}),
        **correlations(walks, settings.settle),
        "step frequency": max_of([100 * abs(row["off"]) for row in frequencies]),
        "double hump": max_of(dip_ratios(forces)[:2]),
    }


def max_of(values: Sequence[float]) -> float:
    """Largest value; NaN if one is NaN."""
    return float(np.max(values))


def training_costs(policy: Policy) -> dict[str, float]:
    """Samples, time [h] and returns of a training; nothing unless the policy is a run folder.

    They are infinite if its episodes never got there.
    """
    folder = Path(policy) if isinstance(policy, str | Path) else None
    history = read_progress(folder) if folder is not None and folder.is_dir() else {}
    if not history:
        return {}
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


def speed_values(numbers: Mapping[str, Any]) -> dict[str, float]:
    """Values of claims on speed, from the numbers of `velocity_tracking` for one policy."""
    held = [
        all(row[key][0] for key in ("survived", "on_feet", "tracked")) for row in numbers["map"]
    ]
    settling = [row["settling"] for row in numbers["steps"]]
    spike = numbers["spike"]
    return {
        "all speeds": float(sum(held)),
        "velocity tracking": max_of([abs(row["mean"] - row["command"]) for row in numbers["map"]]),
        "smooth transitions": float(np.isfinite(settling).sum()),
        "settling": max_of(settling),
        "touchdown spikes": spike["robot"] / spike["model"],
    }


def foot_values(placements: Mapping[float, Placement]) -> dict[str, float]:
    """Values of claims on foot placement [cm], from speeds [m/s] and placements of one policy."""
    error = {speed: _mean(one.error) for speed, one in placements.items()}
    below = [error[speed] for speed in placements if speed < 1.0 - _ROUNDING]
    return {
        "wider feet": float(np.min([_mean(one.outward) for one in placements.values()])),
        "feet below 1 m/s": max_of(below),
        "feet lag": _mean(placements[2.0].offset[:, 0]) - _mean(placements[1.0].offset[:, 0]),
        "feet to 1.0 m/s": max_of([*below, error[1.0]]),
        "feet at 1.5 m/s": error[1.5],
        "feet at 2.0 m/s": error[2.0],
    }


def _mean(lengths: np.ndarray) -> float:
    """Mean of lengths [cm]; NaN without any."""
    return 100 * float(lengths.mean()) if len(lengths) else math.nan


def dip_ratios(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    """Dip ratio of a policy at each speed, from the rows of `ground_force`; NaN after a fall."""
    return [row.get("dip_ratio", math.nan) for row in rows if row["method"] != "model"]


def correlations(walks: Walks, settle: float) -> dict[str, float]:
    """Values of claims on similarity to the model: mean correlations over speeds; NaN after a fall.

    Args:
        walks: walks at `SPEEDS`.
        settle: duration at their beginning that is left out [s].
    """
    if not walks.survived.all():
        return {"velocity oscillation": math.nan, "springy legs": math.nan}
    first = round(settle / CASSIE.policy_period)
    ones = [walks.one(i, first) for i in range(len(SPEEDS))]
    # in place, the model's velocity does not oscillate
    moving = [walk for walk in ones if walk.command[0, 0] > 0]
    return {
        "velocity oscillation": float(np.mean([_speed_correlation(walk) for walk in moving])),
        "springy legs": float(np.mean([_leg_correlation(walk) for walk in ones])),
    }


def _speed_correlation(walk: Walks) -> float:
    robot, model = walk.pelvis_velocity[:, 0, 0], walk.body_velocity[:, 0, 0]
    return float(np.corrcoef(robot, model)[0, 1])


def _leg_correlation(walk: Walks) -> float:
    robot = np.linalg.norm(walk.foot_position - walk.pelvis_position[:, :, None], axis=-1)
    model = np.linalg.norm(walk.body_to_foot, axis=-1)
    return leg_length_correlation(robot[:, 0], model[:, 0])
