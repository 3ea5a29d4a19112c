"""Every claim of the paper's results as a number: what it says, what it published, what is here.

    python -m benchmarks.claims                                          # the shipped policies
    python -m benchmarks.claims --policy runs/seed0 runs/seed1 runs/seed2 --baseline runs/single0

Runs the other benchmarks of a policy and judges what they find. Training cost is read from the runs
that made the policies, where they are folders of runs. Rows with a section are sentences of the
paper; rows without are what this implementation sets itself. The exit status is 1 when a claim that
held in the record (`docs/claims.json`, replaced by `--record`) does not hold any more.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from aslip.errors import AslipError
from aslip.metrics import Placement, leg_length_correlation
from aslip.run import read_progress, write_text
from aslip.walks import Walks
from benchmarks import foot_placement, ground_reaction, step_frequency, velocity_tracking
from benchmarks.common import Common, Interval, constant_walks, markdown, write_report

RECORD = Path("docs/claims.json")
"""Claims as they held when the repository's numbers were made."""

# mean length of training episodes that counts as having learned to walk, of 400 [policy steps]
_WALKING = 350
_SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)
_SLOW = 0.3
# walking before a correlation is taken, and while it is [s]
_SETTLE, _WALK = 4.0, 8.0


@dataclass(frozen=True)
class Config(Common):
    """What to judge."""

    baseline: tuple[str, ...] = ()
    """Policies of `recipes/ppo_single_reference.py`; without them its claims are left out."""
    record: bool = False
    """Keep what is found as the record."""


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
        "IV: learns to step in place after about 25 million timesteps",
        "25",
        "million",
        at_most=25,
    ),
    Claim(
        "return",
        "IV: converges to a reward of almost 300",
        "almost 300",
        "",
        at_least=300,
        digits=0,
    ),
    Claim("training time", "IV: just under five hours on 50 cores", "5", "h", at_most=5),
    Claim(
        "all speeds",
        "IV: able to track all of the walk cycles in the library",
        "all",
        "of 21",
        at_least=21,
        digits=0,
    ),
    Claim(
        "velocity tracking",
        "IV-A: succeeds across the broad set of commanded speeds; largest error of all speeds",
        "0.02",
        "m/s",
        at_most=0.05,
        digits=3,
    ),
    Claim("slow walking", "obeys commands of 0 to 0.3 m/s", "", "m/s", at_most=0.05, digits=3),
    Claim(
        "smooth transitions",
        "IV-A: smoothly transition between reference walk cycles; changes survived",
        "all",
        "of 6",
        at_least=6,
        digits=0,
    ),
    Claim("settling", "settled after changes of 1 m/s, the slowest", "", "s", at_most=1.5),
    Claim(
        "velocity oscillation",
        "IV-A: oscillations in pelvis velocity correspond to the model's; correlation",
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
        "IV-A: at all speeds places its feet slightly wider; the least",
        "1.5",
        "cm",
        at_least=0,
        digits=1,
    ),
    Claim(
        "feet below 1 m/s",
        "IV-A: under 1.0 m/s the placement error does not exceed 10 cm",
        "9.2",
        "cm",
        at_most=10,
        digits=1,
    ),
    Claim(
        "feet above 1 m/s",
        "IV-A: above 1.0 m/s footsteps lag more and more; growth to 2.0 m/s",
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
        "IV-A: double hump ground force at 0 and 1.0 m/s; largest dip ratio",
        "0.67",
        "",
        at_most=0.7,
    ),
    Claim(
        "baseline's single hump",
        "IV-A: single flattened hump for all speeds; least dip ratio",
        "0.92",
        "",
        at_least=0.9,
    ),
    Claim(
        "springy legs",
        "IV-B: changes in leg length directly correspond to the model's; correlation",
        "",
        "",
        at_least=0.5,
    ),
    Claim(
        "step frequency",
        "IV-B: stepping frequency matches; largest difference of all speeds",
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
        value = values[claim.name]
        holds = bool(claim.at_least <= value.mean <= claim.at_most)
        rows.append({**asdict(claim), **vars(value), "limit": claim.limit, "holds": holds})
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
            Interval(row["mean"], row["low"], row["high"]).text(row["digits"])
            + f" {row['unit']}".rstrip(),
            row["limit"],
            "PASS" if row["holds"] else "FAIL",
        ]
        for row in rows
    ]
    header = ["claim", "where the paper says it, or what we ask", "published", "here", "limit", ""]
    passed = sum(row["holds"] for row in rows)
    lines = markdown(header, cells).splitlines()
    lines[1] = "|---|---|---:|---:|---:|---|"
    return "\n".join(lines) + f"\n\n{passed} of {len(rows)} hold; intervals of 95 % over seeds."


# ---------------------------------------------------------------------- values


def measured(config: Config) -> dict[str, Interval]:
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
        "step frequency": one(100 * max(abs(row["off"]) for row in frequencies)),
    }


def one(value: float) -> Interval:
    """A number without an interval."""
    return Interval(float(value), float(value), float(value))


def over_seeds(values: Sequence[float]) -> Interval:
    """Mean and interval of one value a seed."""
    return Interval.of([np.array([value]) for value in values])


def largest(values: np.ndarray) -> Interval:
    """Over seeds, of the largest value (k, seeds) of each; infinite where one has fallen."""
    found = values.max(axis=0)
    return over_seeds(found.tolist()) if np.isfinite(found).all() else one(math.inf)


def cost(policies: Sequence[str]) -> dict[str, Interval]:
    """Samples, time and return of the trainings, of policies that are folders of runs."""
    samples, hours, returns = [], [], []
    for policy in policies:
        history = read_progress(Path(policy)) if Path(policy).is_dir() else {}
        if not history:
            continue
        lengths = np.array(history["episode_length"])
        walking = np.flatnonzero(lengths >= _WALKING)
        samples.append(history["step"][walking[0]] / 1e6 if len(walking) else math.inf)
        hours.append(history["elapsed_s"][-1] / 3600)
        evaluated = np.array(history["eval_return"])
        returns.append(evaluated[np.isfinite(evaluated)][-1])
    if not samples:
        return {}
    found = {"samples": samples, "training time": hours, "return": returns}
    return {name: over_seeds(values) for name, values in found.items()}


def tracking(numbers: dict[str, Any]) -> dict[str, Interval]:
    """Claims on speed."""
    rows = numbers["map"]
    # of each policy: errors of several must not cancel
    off = np.array([[abs(walked - row["command"]) for walked in row["each"]] for row in rows])
    slow = [row["command"] <= _SLOW + 1e-6 for row in rows]
    steps, spikes = numbers["steps"], numbers["spike"]
    return {
        "all speeds": one(sum(not row["fell"] for row in rows)),
        "velocity tracking": largest(off),
        "slow walking": largest(off[slow]),
        "smooth transitions": one(sum(math.isfinite(row["steady_error"]) for row in steps)),
        "settling": one(max(row["settling"] for row in steps)),
        "touchdown spikes": one(spikes["robot"] / spikes["model"]),
    }


def feet(placements: dict[float, list[Placement]]) -> dict[str, Interval]:
    """Claims on where feet are placed [cm]."""

    def error(speed: float) -> Interval:
        return Interval.of([100 * p.error for p in placements[speed]])

    slow = [speed for speed in placements if speed <= 1.0 + 1e-6]
    worst = max((error(speed) for speed in slow), key=lambda interval: interval.mean)
    outward = [Interval.of([100 * p.outward for p in at_speed]) for at_speed in placements.values()]
    growth = [
        100 * (fast.error.mean() - slow.error.mean())
        for fast, slow in zip(placements[2.0], placements[1.0], strict=True)
    ]
    return {
        "wider feet": min(outward, key=lambda interval: interval.mean),
        "feet below 1 m/s": worst,
        "feet above 1 m/s": over_seeds(growth),
        "feet to 1.0 m/s": worst,
        "feet at 1.5 m/s": error(1.5),
        "feet at 2.0 m/s": error(2.0),
    }


def humps(rows: Sequence[dict[str, Any]]) -> dict[str, Interval]:
    """Claims on ground forces; a robot that fell has none."""

    def ratios(method: str, speed: float) -> Interval:
        found = [r for r in rows if (r["method"], r["speed"]) == (method, speed)]
        return over_seeds([r.get("dip_ratio", math.nan) for r in found])

    ours = [ratios("ASLIP", speed) for speed in (0.0, 1.0)]
    values = {"double hump": max(ours, key=lambda interval: interval.mean)}
    if any(row["method"] == "single reference" for row in rows):
        theirs = [ratios("single reference", speed) for speed in (0.0, 1.0, 2.0)]
        values["baseline's single hump"] = min(theirs, key=lambda interval: interval.mean)
    return values


def likeness(walks: Sequence[Walks]) -> dict[str, Interval]:
    """Claims on how the robot moves as the model does: mean correlations over speeds."""
    first = round(_SETTLE / velocity_tracking.POLICY_PERIOD)
    speed, legs = [], []
    for walk in walks:
        upright = [i for i in range(len(_SPEEDS)) if walk.survived[i]]
        ones = [walk.one(i, first) for i in upright]
        # standing on the spot, the model has no forward oscillation
        moving = [w for w in ones if w.command[0, 0] > 0]
        speed.append(np.mean([_speed_correlation(w) for w in moving]) if moving else math.nan)
        legs.append(np.mean([_leg_correlation(w) for w in ones]) if ones else math.nan)
    return {"velocity oscillation": over_seeds(speed), "springy legs": over_seeds(legs)}


def _speed_correlation(walk: Walks) -> float:
    robot, model = walk.pelvis_velocity[:, 0, 0], walk.body_velocity[:, 0, 0]
    return float(np.corrcoef(robot, model)[0, 1])


def _leg_correlation(walk: Walks) -> float:
    robot = np.linalg.norm(walk.foot_position - walk.pelvis_position[:, :, None], axis=-1)
    model = np.linalg.norm(walk.body_to_foot, axis=-1)
    return leg_length_correlation(robot[:, 0], model[:, 0])


if __name__ == "__main__":
    try:
        raise SystemExit(min(main(tyro.cli(Config)), 1))
    except AslipError as error:
        raise SystemExit(f"error: {error}") from None
