"""Every claim of the paper's results as a number: what it says, what it published, what is here.

    python -m benchmarks.claims --baseline single_reference      # the shipped policies
    python -m benchmarks.claims --policy runs/seed0 runs/seed1 --baseline single_reference

Runs the other benchmarks of a policy and judges what they find. Training cost is read from the runs
that made the policies, where they are folders of runs. Rows with a section are sentences of the
paper; rows without are what this implementation sets itself. The exit status is 1 when a claim that
held in the record (`docs/claims.json`, replaced by `--record`) does not hold any more.
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
    """Policies of `recipes/ppo_single_reference.py`; without them its claims are left out."""
    record: bool = False
    """Keep what is found as the record."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from aslip.robot import CASSIE
from aslip.training.run import read_progress, write_text
from aslip.walking import TRACKING_TOLERANCE, Walks, markdown
from aslip.walking.metrics import Placement, leg_length_correlation
from benchmarks import foot_placement, ground_reaction, step_frequency, velocity_tracking
from benchmarks.common import WALKING_LENGTH, Interval, constant_walks, write_report

RECORD = Path("docs/claims.json")
"""Claims as they held when the repository's numbers were made."""

_SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)
_SLOW = 0.3
# walking before a correlation is taken, and while it is [s]
_SETTLE, _WALK = 4.0, 8.0


@dataclass(frozen=True)
class Claim:
    """One row."""

    name: str
    sentence: str
    """The paper's, with its section; or what we set ourselves."""
    published: str
    """Value, if there is one."""
    unit: str
    at_least: float = -math.inf
    """The claim holds if the value is not below this..."""
    at_most: float = math.inf
    """...and not above this."""
    digits: int = 2

    @property
    def limit(self) -> str:
        """The condition, for people."""
        if math.isfinite(self.at_least):
            return f"≥ {self.at_least:g}"
        return f"≤ {self.at_most:g}"


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "samples",
        "V: learns to step in place after about 25 million timesteps",
        "25",
        "million",
        at_most=25,
    ),
    Claim(
        "return",
        "V: converges to a reward of almost 300",
        "almost 300",
        "",
        at_least=300,
        digits=0,
    ),
    Claim("training time", "V: just under five hours on 50 cores", "5", "h", at_most=5),
    Claim(
        "all speeds",
        "V: able to track all of the walk cycles in the library; survived on its feet,"
        f" mean speed within {TRACKING_TOLERANCE:g} m/s",
        "all",
        "of 21",
        at_least=21,
        digits=1,
    ),
    Claim(
        "velocity tracking",
        "V-A: succeeds across the broad set of commanded speeds; largest error of all speeds",
        "0.02",
        "m/s",
        at_most=0.05,
        digits=3,
    ),
    Claim("slow walking", "obeys commands of 0 to 0.3 m/s", "", "m/s", at_most=0.05, digits=3),
    Claim(
        "smooth transitions",
        "V-A: smoothly transition between reference walk cycles; changes survived",
        "all",
        "of 6",
        at_least=6,
        digits=1,
    ),
    Claim("settling", "settled after changes of 1 m/s, the slowest", "", "s", at_most=1.5),
    Claim(
        "velocity oscillation",
        "V-A: oscillations in pelvis velocity correspond to the model's; correlation",
        "",
        "",
        at_least=0.5,
    ),
    Claim(
        "touchdown spikes",
        "Fig. 5: does not emulate the spikes at touchdown; robot's over model's",
        "",
        "",
        at_most=0.5,
    ),
    Claim(
        "wider feet",
        "V-A: at all speeds places its feet slightly wider; the least",
        "1.5",
        "cm",
        at_least=0,
        digits=1,
    ),
    Claim(
        "feet below 1 m/s",
        "V-A: under 1.0 m/s the placement error does not exceed 10 cm",
        "9.2",
        "cm",
        at_most=10,
        digits=1,
    ),
    Claim(
        "feet above 1 m/s",
        "V-A: above 1.0 m/s footsteps lag more and more; growth of the error to 2.0 m/s",
        "34",
        "cm",
        at_least=0,
        digits=1,
    ),
    Claim("feet to 1.0 m/s", "largest mean error up to 1.0 m/s", "9.2", "cm", at_most=3, digits=1),
    Claim("feet at 1.5 m/s", "mean error", "24.5", "cm", at_most=5, digits=1),
    Claim("feet at 2.0 m/s", "mean error", "43.2", "cm", at_most=8, digits=1),
    Claim(
        "double hump",
        "V-A: double hump ground force at 0 and 1.0 m/s; largest dip ratio",
        "0.67",
        "",
        at_most=0.7,
    ),
    Claim(
        "baseline's single hump",
        "V-A: single flattened hump for all speeds; least dip ratio",
        "0.92",
        "",
        at_least=0.9,
    ),
    Claim(
        "springy legs",
        "V-B: changes in leg length directly correspond to the model's; correlation",
        "",
        "",
        at_least=0.5,
    ),
    Claim(
        "step frequency",
        "V-B: stepping frequency matches; largest difference of all speeds",
        "0",
        "%",
        at_most=2,
    ),
)


def main(config: Config) -> int:
    """Measure, print and write; returns how many claims held in the record and do not now."""
    values = measured(config)
    rows: list[dict[str, Any]] = []
    for claim in CLAIMS:
        if claim.name not in values:
            continue
        value = over_seeds(values[claim.name])
        holds = bool(claim.at_least <= value.mean <= claim.at_most)
        each = [float(found) for found in values[claim.name]]
        row = {**asdict(claim), **vars(value), "each": each, "limit": claim.limit, "holds": holds}
        rows.append(row)
    write_report(config, "claims", {"claims": rows}, table(rows))
    lost = broken(rows, read_record())
    for name in lost:
        print(f"held before and does not now: {name}")
    if config.record:
        write_record(config, rows)
    return len(lost)


def write_record(config: Config, rows: Sequence[dict[str, Any]]) -> None:
    """Keep which claims hold, for which policies: by name, where they lie is nobody's business."""
    names = {
        key: [Path(policy).name for policy in policies]
        for key, policies in (("policies", config.policy), ("baseline", config.baseline))
    }
    kept = {**names, "claims": {row["name"]: row["holds"] for row in rows}}
    write_text(RECORD, json.dumps(kept, indent=1) + "\n")


def read_record() -> dict[str, bool]:
    """Which claims held; none if there is no record."""
    return json.loads(RECORD.read_text())["claims"] if RECORD.exists() else {}


def broken(rows: Sequence[dict[str, Any]], record: dict[str, bool]) -> list[str]:
    """Names of claims that held in the record and do not hold in the rows."""
    return [row["name"] for row in rows if record.get(row["name"]) and not row["holds"]]


def table(rows: Sequence[dict[str, Any]]) -> str:
    """A row a claim."""
    cells = [
        [
            row["name"],
            row["sentence"],
            f"{row['published']} {row['unit']}".strip() if row["published"] else "",
            measure(row),
            row["limit"],
            "PASS" if row["holds"] else "FAIL",
        ]
        for row in rows
    ]
    header = ["claim", "where the paper says it, or what we ask", "published", "here", "limit", ""]
    passed = sum(row["holds"] for row in rows)
    align = ["---", "---", "---:", "---:", "---:", "---"]
    text = markdown(header, cells, align)
    return f"{text}\n\n{passed} of {len(rows)} hold; intervals of 95 % over seeds."


def measure(row: dict[str, Any]) -> str:
    """What was measured, for people."""
    if math.isnan(row["mean"]):
        return "none"
    interval = Interval.of_row(row)
    return f"{interval.text(row['digits'])} {row['unit']}".rstrip()


# ---------------------------------------------------------------------- values

Values = Mapping[str, Sequence[float]]
"""Claim -> its value for each seed, NaN where the robot fell."""


def measured(config: Config) -> Values:
    """Value of each claim that can be judged."""
    common = {"policy": config.policy, "truth": config.truth, "seed": config.seed}
    common["out"] = config.out
    placements = foot_placement.main(foot_placement.Config(**common))
    speeds = velocity_tracking.main(velocity_tracking.Config(**common))
    frequencies = step_frequency.main(step_frequency.Config(**common))
    forces = ground_reaction.main(
        ground_reaction.Config(**common, baseline=config.baseline)  # pyright: ignore
    )
    walks = constant_walks(config, _SPEEDS, _SETTLE + _WALK)
    return {
        **cost(config.policy),
        **tracking(speeds),
        **feet(placements),
        **humps(forces),
        **likeness(walks),
        "step frequency": worst([[100 * abs(off) for off in row["each"]] for row in frequencies]),
    }


def over_seeds(values: Sequence[float]) -> Interval:
    """Mean and interval of one value a seed; none if a seed has none, it would hide a failure."""
    if not np.isfinite(values).all():
        return Interval(math.nan, math.nan, math.nan)
    return Interval.of([np.array([value]) for value in values])


def worst(values: Sequence[Sequence[float]]) -> list[float]:
    """Each seed's largest of (conditions, seeds): seeds must not make up for each other."""
    return np.max(values, axis=0).tolist()


def least(values: Sequence[Sequence[float]]) -> list[float]:
    """Each seed's smallest of (conditions, seeds)."""
    return np.min(values, axis=0).tolist()


def cost(policies: Sequence[str]) -> Values:
    """Samples, time and return of the trainings, of policies that are folders of runs."""
    samples, hours, returns = [], [], []
    for policy in policies:
        history = read_progress(Path(policy)) if Path(policy).is_dir() else {}
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


def tracking(numbers: dict[str, Any]) -> Values:
    """Claims on speed."""
    rows = numbers["map"]
    off = [[abs(mean - row["command"]) for mean in row["each"]] for row in rows]
    slow = [off[i] for i, row in enumerate(rows) if row["command"] <= _SLOW + 1e-6]
    steps, spikes = [row["each"] for row in numbers["steps"]], numbers["spike"]["each"]
    return {
        "all speeds": np.sum([_all_held(row) for row in rows], axis=0).tolist(),
        "velocity tracking": worst(off),
        "slow walking": worst(slow),
        "smooth transitions": np.isfinite([s["steady_error"] for s in steps]).sum(axis=0).tolist(),
        "settling": worst([s["settling"] for s in steps]),
        "touchdown spikes": [s["robot"] / s["model"] for s in spikes],
    }


def _all_held(row: dict[str, Any]) -> np.ndarray:
    """(seeds,) whether a walk survived on its feet and tracked its command."""
    return np.all([row[key] for key in ("survived", "on_feet", "tracked")], axis=0)


def feet(placements: dict[float, list[Placement]]) -> Values:
    """Claims on where feet are placed [cm]."""
    error = {speed: _means([p.error for p in ps]) for speed, ps in placements.items()}
    outward = [_means([p.outward for p in ps]) for ps in placements.values()]
    slow = worst([error[speed] for speed in placements if speed <= 1.0 + 1e-6])
    return {
        "wider feet": least(outward),
        "feet below 1 m/s": slow,
        "feet above 1 m/s": np.subtract(error[2.0], error[1.0]).tolist(),
        "feet to 1.0 m/s": slow,
        "feet at 1.5 m/s": error[1.5],
        "feet at 2.0 m/s": error[2.0],
    }


def _means(lengths: Sequence[np.ndarray]) -> list[float]:
    return [100 * float(length.mean()) if len(length) else math.nan for length in lengths]


def humps(rows: Sequence[dict[str, Any]]) -> Values:
    """Claims on ground forces; a robot that fell has none."""

    def ratios(method: str, speed: float) -> list[float]:
        found = [r for r in rows if (r["method"], r["speed"]) == (method, speed)]
        return [r.get("dip_ratio", math.nan) for r in found]

    values = {"double hump": worst([ratios("ASLIP", speed) for speed in (0.0, 1.0)])}
    if any(row["method"] == "single reference" for row in rows):
        theirs = [ratios("single reference", speed) for speed in (0.0, 1.0, 2.0)]
        values["baseline's single hump"] = least(theirs)
    return values


def likeness(walks: Sequence[Walks]) -> Values:
    """Claims on how the robot moves as the model does: mean correlations over speeds."""
    first = round(_SETTLE / CASSIE.policy_period)
    speed, legs = [], []
    for walk in walks:
        if not walk.survived.all():
            speed.append(math.nan)
            legs.append(math.nan)
            continue
        ones = [walk.one(i, first) for i in range(len(_SPEEDS))]
        # standing on the spot, the model has no forward oscillation
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
