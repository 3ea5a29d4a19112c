"""Claims of the paper in numbers: sentence, published value, measured value, verdict.

    python -m benchmarks.claims --baseline single_reference      # the shipped policies
    python -m benchmarks.claims --policy runs/seed0 runs/seed1 --baseline single_reference

Runs the other benchmarks and judges their results. Training costs are read from run folders, if
policies are given as such. Rows with a section number are sentences of the paper; others are
requirements of this project. The exit status is 1 if a claim that holds in the record
(`docs/claims.json`, replaced by `--record`) no longer holds.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line
from benchmarks.flags import Common


@dataclass(frozen=True)
class Config(Common):
    """Settings of the benchmark."""

    baseline: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py single-reference`, for the claims about the baseline."""
    record: bool = False
    """Replace the record."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from aslip.robot import CASSIE
from aslip.training.progress import read_progress
from aslip.training.run import write_text
from aslip.walking import Walks, markdown
from aslip.walking.metrics import Placement, leg_length_correlation
from benchmarks import foot_placement, ground_reaction, step_frequency, velocity_tracking
from benchmarks.claim_list import CLAIMS
from benchmarks.common import (
    WALKING_LENGTH,
    Interval,
    MakeEnv,
    Policy,
    constant_walks,
    load_subjects,
    write_report,
)

RECORD = Path("docs/claims.json")
"""Record of the claims that hold for the shipped policies."""

_SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)
_SLOW = 0.3
# duration before the correlation, and of it [s]
_SETTLE, _WALK = 4.0, 8.0


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> int:
    """Measure, print and write; returns the number of claims that no longer hold.

    Args:
        config: the settings.
        policy: policy to measure; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    values = claim_values(config, policy, make_env)
    rows: list[dict[str, Any]] = []
    for claim in CLAIMS:
        if claim.name not in values:
            continue
        value = interval_over_seeds(values[claim.name])
        holds = bool(claim.at_least <= value.mean <= claim.at_most)
        each = [float(found) for found in values[claim.name]]
        row = {**asdict(claim), **vars(value), "each": each, "limit": claim.limit, "holds": holds}
        rows.append(row)
    write_report(config, policy, "claims", {"claims": rows}, table(rows))
    lost = lost_claims(rows, read_record())
    for name in lost:
        print(f"no longer holds: {name}")
    if config.record:
        write_record(config, rows)
    return len(lost)


def write_record(config: Config, rows: Sequence[dict[str, Any]]) -> None:
    """Write the record: which claims hold, and names of policies without folders."""
    names = {
        key: [Path(policy).name for policy in policies]
        for key, policies in (("policies", config.policy), ("baseline", config.baseline))
    }
    kept = {**names, "claims": {row["name"]: row["holds"] for row in rows}}
    write_text(RECORD, json.dumps(kept, indent=1) + "\n")


def read_record() -> dict[str, bool]:
    """Read which claims hold in the record; empty without a record."""
    return json.loads(RECORD.read_text())["claims"] if RECORD.exists() else {}


def lost_claims(rows: Sequence[dict[str, Any]], record: dict[str, bool]) -> list[str]:
    """Names of claims that hold in the record and not in the rows."""
    return [row["name"] for row in rows if record.get(row["name"]) and not row["holds"]]


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Table of claims."""
    cells = [
        [
            row["name"],
            row["sentence"],
            f"{row['published']} {row['unit']}".strip() if row["published"] else "",
            value_text(row),
            row["limit"],
            "PASS" if row["holds"] else "FAIL",
        ]
        for row in rows
    ]
    header = [
        "claim",
        "sentence of the paper, or requirement",
        "published",
        "measured",
        "limit",
        "",
    ]
    passed = sum(row["holds"] for row in rows)
    align = ["---", "---", "---:", "---:", "---:", "---"]
    text = markdown(header, cells, align)
    return f"{text}\n\n{passed} of {len(rows)} hold; 95 % intervals over seeds."


def value_text(row: dict[str, Any]) -> str:
    """Value of a claim as text."""
    if math.isnan(row["mean"]):
        return "none"
    interval = Interval.of_row(row)
    return f"{interval.text(row['digits'])} {row['unit']}".rstrip()


# ---------------------------------------------------------------------- values

Values = Mapping[str, Sequence[float]]
"""Name of a claim -> its value for each seed; NaN after a fall."""


def claim_values(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> Values:
    """Run the benchmarks, and compute the value of each claim that can be judged."""
    common: dict[str, Any] = {"policy": config.policy, "truth": config.truth}
    common |= {"seed": config.seed, "out": config.out}
    of = (policy, make_env)
    placements = foot_placement.main(foot_placement.Config(**common), *of)
    speeds = velocity_tracking.main(velocity_tracking.Config(**common), *of)
    frequencies = step_frequency.main(step_frequency.Config(**common), *of)
    forces = ground_reaction.main(ground_reaction.Config(**common, baseline=config.baseline), *of)
    walks = constant_walks(config, load_subjects(config, *of), _SPEEDS, _SETTLE + _WALK)
    off = [[100 * abs(off) for off in row["each"]] for row in frequencies]
    return {
        **training_costs(config.policy if policy is None else [policy]),
        **speed_claims(speeds),
        **foot_claims(placements),
        **force_claims(forces),
        **correlation_claims(walks),
        "step frequency": largest_by_seed(off),
    }


def interval_over_seeds(values: Sequence[float]) -> Interval:
    """Interval over seeds; NaN if any seed's value is missing, which would hide a failure."""
    if not np.isfinite(values).all():
        return Interval(math.nan, math.nan, math.nan)
    return Interval.of([np.array([value]) for value in values])


def largest_by_seed(values: Sequence[Sequence[float]]) -> list[float]:
    """Largest value of each seed, from (conditions, seeds)."""
    return np.max(values, axis=0).tolist()


def smallest_by_seed(values: Sequence[Sequence[float]]) -> list[float]:
    """Smallest value of each seed, from (conditions, seeds)."""
    return np.min(values, axis=0).tolist()


def training_costs(policies: Sequence[Policy]) -> Values:
    """Samples, time and return of trainings, for policies given as run folders."""
    samples, hours, returns = [], [], []
    for policy in policies:
        if not isinstance(policy, str | Path) or not Path(policy).is_dir():
            continue
        history = read_progress(Path(policy))
        if not history:
            continue
        lengths = np.array(history["episode_length"])
        walking = np.flatnonzero(lengths >= WALKING_LENGTH)
        samples.append(history["step"][walking[0]] / 1e6 if len(walking) else math.nan)
        hours.append(history["elapsed_s"][-1] / 3600)
        evaluated = np.array(history["eval_return"])
        returns.append([math.nan, *evaluated[np.isfinite(evaluated)]][-1])
    found = {"samples": samples, "training time": hours, "return": returns}
    return found if samples else {}


def speed_claims(numbers: dict[str, Any]) -> Values:
    """Values of claims on speed, from the numbers of `velocity_tracking`."""
    rows = numbers["map"]
    off = [[abs(mean - row["command"]) for mean in row["each"]] for row in rows]
    slow = [off[i] for i, row in enumerate(rows) if row["command"] <= _SLOW + 1e-6]
    steps, spikes = [row["each"] for row in numbers["steps"]], numbers["spike"]["each"]
    return {
        "all speeds": np.sum([_all_held(row) for row in rows], axis=0).tolist(),
        "velocity tracking": largest_by_seed(off),
        "slow walking": largest_by_seed(slow),
        "smooth transitions": np.isfinite([s["steady_error"] for s in steps]).sum(axis=0).tolist(),
        "settling": largest_by_seed([s["settling"] for s in steps]),
        "touchdown spikes": [s["robot"] / s["model"] for s in spikes],
    }


def _all_held(row: dict[str, Any]) -> np.ndarray:
    """(seeds,) whether the walk survived on its feet and tracked its command."""
    return np.all([row[key] for key in ("survived", "on_feet", "tracked")], axis=0)


def foot_claims(placements: dict[float, list[Placement]]) -> Values:
    """Values of claims on foot placement [cm]."""
    error = {speed: _means([p.error for p in ps]) for speed, ps in placements.items()}
    outward = [_means([p.outward for p in ps]) for ps in placements.values()]
    slow = largest_by_seed([error[speed] for speed in placements if speed <= 1.0 + 1e-6])
    return {
        "wider feet": smallest_by_seed(outward),
        "feet below 1 m/s": slow,
        "feet above 1 m/s": np.subtract(error[2.0], error[1.0]).tolist(),
        "feet to 1.0 m/s": slow,
        "feet at 1.5 m/s": error[1.5],
        "feet at 2.0 m/s": error[2.0],
    }


def _means(lengths: Sequence[np.ndarray]) -> list[float]:
    return [100 * float(length.mean()) if len(length) else math.nan for length in lengths]


def force_claims(rows: Sequence[dict[str, Any]]) -> Values:
    """Values of claims on ground forces, from the rows of `ground_reaction`."""

    def ratios(method: str, speed: float) -> list[float]:
        found = [r for r in rows if (r["method"], r["speed"]) == (method, speed)]
        return [r.get("dip_ratio", math.nan) for r in found]

    values = {"double hump": largest_by_seed([ratios("ASLIP", speed) for speed in (0.0, 1.0)])}
    if any(row["method"] == "single reference" for row in rows):
        theirs = [ratios("single reference", speed) for speed in (0.0, 1.0, 2.0)]
        values["baseline's single hump"] = smallest_by_seed(theirs)
    return values


def correlation_claims(walks: Sequence[Walks]) -> Values:
    """Values of claims on similarity to the model: mean correlations over speeds."""
    first = round(_SETTLE / CASSIE.policy_period)
    speed, legs = [], []
    for walk in walks:
        if not walk.survived.all():
            speed.append(math.nan)
            legs.append(math.nan)
            continue
        ones = [walk.one(i, first) for i in range(len(_SPEEDS))]
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


if __name__ == "__main__":
    with one_line_errors():
        raise SystemExit(min(main(CONFIG), 1))
