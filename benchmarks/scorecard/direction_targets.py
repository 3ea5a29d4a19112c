"""Targets of walks in all directions: one table of the other benchmarks' numbers, with verdicts.

    python -m benchmarks.scorecard.direction_targets --policy runs/ppo_directions
    python -m benchmarks.scorecard.direction_targets --policy runs/seed1 runs/seed2 --record s.json

Several policies count as seeds of one method: values are means with 95 % intervals over seeds, and
a target is met if the whole interval meets it. A policy alone has intervals over its commands and
walks. Each policy walks at commands of its own, drawn from
the seed of its training, so that with the default sizes five policies walk at 1000 commands and
through 10 000 changes. Tables and pictures of the benchmarks are written to a folder for each
policy.

With `--record`, the values of each policy are kept in a file. Its policies are not measured again,
and the table is over all of them: after an interruption, the same command goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import SWEEPS, Directions, Sweeps

_ROBOTS = 50  # whose commands change


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    out: Path = Path("runs/direction_targets")
    """Folder for the table and results."""
    commands: int = 200
    """Number of random commands whose mean velocity is measured."""
    changes: int = 2000
    """Number of sudden changes of the command."""
    placements: int = 40
    """Number of random commands at which the foot placement is measured."""
    stops: int = 12
    """Number of walks that stop, stand and start."""
    pushes: int = 16
    """Directions of pushes, evenly around the robot."""
    walks: int = 16
    """Walks at each value of a parameter of robot or floor."""
    stand: float = 60.0
    """Time of standing [s]."""
    path: float = 300.0
    """Time on the figure of eight [s]."""
    record: Path | None = None
    """File with the values of each policy; its policies count, too."""

    def __post_init__(self) -> None:
        """Check the numbers of footstep commands and changes."""
        super().__post_init__()
        if self.placements < 1:
            raise ConfigurationError(f"placements must be 1 or more, got {self.placements}")
        if self.changes > _ROBOTS and self.changes % _ROBOTS:
            raise ConfigurationError(
                f"changes must be at most {_ROBOTS}, or a multiple of it, got {self.changes}"
            )


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.library.footholds import Footholds
from aslip.policy import read_card
from aslip.transforms.standing import transitions_of
from benchmarks.common import (
    MakeEnv,
    Policy,
    chosen_library,
    load_with_library,
    policy_name,
    record_subject,
    write_report,
)
from benchmarks.directions import command_changes, figure_of_eight, stops, tracking
from benchmarks.directions.random_commands import random_commands
from benchmarks.paper import foot_placement
from benchmarks.robustness import pushes, walking_quality
from benchmarks.scorecard.claim_list import Claim
from benchmarks.scorecard.claims import describe, judge, value_text, verdict
from benchmarks.scorecard.target_record import TargetRecord


def _falls(name: str, measure: str, digits: int = 0) -> Claim:
    """Target of a count or share that has to be zero for each seed."""
    return Claim(name, measure, at_most=0.0, every_seed=True, digits=digits)


def _survived(name: str, what: str) -> Claim:
    """Target of a sweep of robot or floor."""
    return Claim(name, f"walks survived with {what} [%]", at_least=98.0, digits=1)


TARGETS: Final = (
    Claim("samples", "policy steps of the training [million]", at_most=5.0),
    Claim("time", "time of the training [min]", at_most=90.0, digits=0),
    _falls("falls, walks", "falls per 1000 walks at random commands"),
    Claim(
        "velocity", "error of the mean velocity, mean over commands [m/s]", at_most=0.03, digits=3
    ),
    Claim("velocity, 95 %", "error that 95 % of commands stay below [m/s]", at_most=0.06, digits=3),
    Claim(
        "yaw rate", "error of the mean yaw rate, mean over commands [rad/s]", at_most=0.03, digits=3
    ),
    Claim(
        "yaw rate, 95 %", "error that 95 % of commands stay below [rad/s]", at_most=0.06, digits=3
    ),
    _falls("falls, changes", "falls per 10 000 sudden changes of the command", digits=1),
    _falls("falls, stops", "share of walks with a stop that fall at any time [%]", digits=1),
    _falls("unplanted", "share of these that stand without planting both feet [%]", digits=1),
    Claim("drift", "largest drift of the pelvis in standing [cm]", at_most=1.0),
    Claim("turn", "largest turn of the pelvis in standing [deg]", at_most=0.5),
    _falls("lifted feet", "times a foot is off the ground in standing, of all walks"),
    Claim("stop", "time from the wish at 1 m/s to planted feet, mean over phases [s]", at_most=1.0),
    Claim("power, standing", "positive joint power in standing [W]", at_most=40.0, digits=0),
    Claim(
        "feet, straight",
        "foot placement error, largest mean of 0 to 2 m/s [cm]",
        at_most=3.0,
        digits=1,
    ),
    Claim(
        "feet, turns", "foot placement error, mean over random commands [cm]", at_most=3.5, digits=1
    ),
    _falls(
        "no footsteps", "share of these commands at which it falls or does not step [%]", digits=1
    ),
    Claim(
        "no contact",
        "time without ground contact, largest of 0 to 2 m/s [%]",
        at_most=1.0,
        digits=1,
    ),
    Claim("force", "largest foot force over weight, at 1 and 2 m/s", at_most=1.5),
    Claim("slip", "time at the limit of friction, largest of 0 to 2 m/s [%]", at_most=0.5),
    Claim("power, 1 m/s", "positive joint power over weight and speed", at_most=0.50),
    Claim("power, 2 m/s", "positive joint power over weight and speed", at_most=0.55),
    Claim(
        "pushes, least",
        "largest impulse survived at 1 m/s, worst direction and phase [N s]",
        at_least=30.0,
        digits=1,
    ),
    Claim("pushes, mean", "largest impulse survived at 1 m/s, mean [N s]", at_least=45.0, digits=1),
    _survived("friction", "a floor friction of 0.4 to 1.2"),
    _survived("payload", "0 to 16 kg of payload"),
    _survived("slope", "slopes from -9 to 9 degrees"),
    _survived("delay", "torque delays of 0 to 9 ms"),
    _survived("motors", "motors of 70 to 140 % of their strength"),
    Claim(
        "path",
        "mean distance from the figure of eight [cm]; no value after a fall",
        at_most=10.0,
        digits=1,
    ),
)
"""Targets for the nominal robot, unless the measure says otherwise."""

_SWEPT: Final[Mapping[str, tuple[str, float, float]]] = {
    "friction": ("floor_friction", 0.4, 1.2),
    "payload": ("payload", 0.0, 16.0),
    "slope": ("slope", -9.0, 9.0),
    "delay": ("torque_delay", 0.0, 9.0),
    "motors": ("motor_strength", 0.7, 1.4),
}
"""Parameter of a target, and the range of its displayed values that count."""

_SPEEDS: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
_ONE, _TWO = 2, 4  # places of 1 and 2 m/s
_STOPS: Final = 8  # stops at 1 m/s, each at another phase
_NOT_RECORDED: Final = ("policy", "out", "record", "library")  # a hash tells the library


def main(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> list[dict[str, Any]]:
    """Measure and print; return a row for each target.

    Args:
        config: the settings.
        policy: policy to measure; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.

    Raises:
        ConfigurationError: a setting is invalid, two policies have the same name, the library has
            no stop and start or no gaits up to 2 m/s, or there is a record and a policy or an
            environment of the caller, which it cannot name.
    """
    policies: list[Policy] = [*config.policy] if policy is None else [policy]
    _check(config, policies)
    about, names = "", {}
    if config.record is None:
        found = [measure(config, one, make_env) for one in policies]
    elif policy is not None or make_env is not None:
        raise ConfigurationError(
            f"the record {str(config.record)!r} holds policies of files in their own environments;"
            " leave out record, or policy and make_env"
        )
    else:
        record = recorded(config, config.record)
        found, about = record.values(), f"\n\n{trainings_text(record)}"
        names = {"policies": [one["name"] for one in record.policies]}
        if len(found) > 1:
            about += f"\n\n{table_of_each(record)}"
    rows = [
        {**vars(claim), "found": judged(config, claim, [values[claim.name] for values in found])}
        for claim in TARGETS
    ]
    text = f"{table(rows)}\n\n{falls_text(config, found)}{about}"
    write_report(config, policy, "direction_targets", {**names, "rows": rows}, text)
    return rows


def _check(config: Config, policies: Sequence[Policy]) -> None:
    """Check what would fail after minutes otherwise; see `main`."""
    for one in policies:
        benchmarks_of(config, one)
    names = [describe(one)["name"] for one in policies]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigurationError(f"policies must differ in name, several have {twice}")
    library = chosen_library(config)
    if library is not None:
        transitions_of(library)
        for speed in _SPEEDS:
            library.check_command((speed, 0.0, 0.0))


def benchmarks_of(config: Config, policy: Policy) -> dict[str, Any]:
    """Settings of each benchmark for a policy, by its name.

    Raises:
        ConfigurationError: a setting is invalid.
    """
    out = results_folder(config.out, policy)
    common: dict[str, Any] = {"out": out, "policy": (policy_name(policy),), "truth": config.truth}
    common |= {"library": config.library, "seed": config.seed + (describe(policy)["seed"] or 0)}
    ahead = {"speeds": (1.0,) * _STOPS, "walks": _STOPS, "duration": 0.5, "out": out / "stops"}
    return {
        "tracking": tracking.Config(**common, commands=config.commands),
        "transitions": command_changes.Config(
            **common, changes=config.changes, robots=min(_ROBOTS, config.changes)
        ),
        "standing": stops.Config(**common, walks=config.stops, duration=config.stand),
        "stops": stops.Config(**{**common, **ahead}),
        "path": figure_of_eight.Config(**common, duration=config.path),
        "quality": walking_quality.Config(**common, speeds=_SPEEDS),
        "perturbation": pushes.Config(**common, walks=config.walks, directions=config.pushes),
        "straight": foot_placement.Config(**common, speeds=_SPEEDS),
        "turns": foot_placement.Config(**common),
    }


def measure(config: Config, policy: Policy, make_env: MakeEnv | None = None) -> dict[str, Interval]:
    """Value of each target for one policy; NaN where falls leave nothing to measure.

    Intervals are over commands or walks; where there are none, both ends are the value.

    Falls at random commands, in changes and in stops have targets of their own, and the other
    values are over the walks without a fall. The largest values of straight walks, and forces, are
    NaN after any fall in these.
    """
    settings, of = benchmarks_of(config, policy), (policy, make_env)
    (errors,) = tracking.main(settings["tracking"], *of)
    (changed,) = command_changes.main(settings["transitions"], *of)
    (stood,) = stops.main(settings["standing"], *of)
    (stopped,) = stops.main(settings["stops"], *of)
    (walked,) = figure_of_eight.main(settings["path"], *of)
    quality = walking_quality.main(settings["quality"], *of)
    survived = pushes.main(settings["perturbation"], *of)
    falls, changes = len(changed["falls"]), changed["changes"]
    values: dict[str, float | Interval] = {
        **training_values(policy),
        "falls, walks": Interval.of_share(errors["falls"], config.commands).scaled(1e3),
        "velocity": Interval.of_row(errors["speed"]),
        "velocity, 95 %": Interval.of_row(errors["speed_p95"]),
        "yaw rate": Interval.of_row(errors["turn"]),
        "yaw rate, 95 %": Interval.of_row(errors["turn_p95"]),
        "falls, changes": Interval.of_share(falls, changes).scaled(1e4),
        **standing_values(stood, stopped),
        **foot_values(config, settings, *of),
        **quality_values(quality),
        **perturbation_values(config, survived),
        "path": math.nan if walked["fell"] else 100 * walked["truth"],
    }
    return {
        name: one if isinstance(one, Interval) else Interval(one, one, one)
        for name, one in values.items()
    }


def results_folder(out: Path, policy: Policy) -> Path:
    """Folder for tables and pictures of a policy's benchmarks."""
    return out / describe(policy)["name"]


def recorded(config: Config, path: Path) -> TargetRecord:
    """Record of values, after the policies of the settings were added.

    Raises:
        FileDamagedError: see `open_record`.
        ConfigurationError: see `open_record`; or the record has another policy of the same name.
    """
    record = open_record(config, path)
    for policy in config.policy:
        record.check(policy)
    for policy in config.policy:
        if policy not in record:
            record.add(policy, measure(config, policy))
    return record


def open_record(config: Config, path: Path) -> TargetRecord:
    """Record of values that were measured with given settings; see `TargetRecord`.

    Raises:
        FileDamagedError: the file is no record.
        ConfigurationError: its policies were measured with other settings, or for other targets.
    """
    settings = {k: v for k, v in asdict(config).items() if k not in _NOT_RECORDED}
    library = chosen_library(config)
    settings["library_sha256"] = None if library is None else library.sha256
    return read_record(path, settings)


def read_record(path: Path, settings: Mapping[str, Any]) -> TargetRecord:
    """Record of values that were measured with given settings, or with any if they are empty.

    Raises:
        FileDamagedError: the file is no record.
        ConfigurationError: its policies were measured with other settings, or for other targets.
    """
    record, names = TargetRecord(path, settings), {claim.name for claim in TARGETS}
    if other := sorted(set().union(*(names ^ values.keys() for values in record.values()))):
        raise ConfigurationError(
            f"the record {str(path)!r} is of another version, whose targets differ: {other}; use"
            " another file"
        )
    return record


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
    config: Config, settings: Mapping[str, Any], policy: Policy, make_env: MakeEnv | None
) -> dict[str, float | Interval]:
    """Foot placement errors of straight walks, and of walks at random commands [cm].

    Args:
        config: the settings.
        settings: those of the benchmarks.
        policy: the policy.
        make_env: function that makes the environment, or None.
    """
    placed = foot_placement.main(settings["straight"], policy, make_env)
    straight = [_mean(one.error) for ones in placed.values() for one in ones]
    subjects, library = load_with_library(settings["turns"], policy, make_env)
    command = random_commands(library, config.placements, settings["turns"].seed)
    steps = foot_placement.recorded_steps()
    walks = record_subject(settings["turns"], subjects[0], np.tile(command, (steps, 1, 1)))
    footholds = Footholds(library)
    turns = np.array(
        [
            _mean(foot_placement.walk_placement(walks, i, tuple(one), footholds).error)
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


def perturbation_values(config: Config, numbers: Mapping[str, Any]) -> dict[str, float | Interval]:
    """Values of `benchmarks.robustness.pushes`."""
    impulses = [cell["mean"] for row in numbers["pushes"] for cell in row["phases"]]
    found: dict[str, float | Interval] = {
        "pushes, least": float(np.min(impulses)),
        "pushes, mean": float(np.mean(impulses)),
    }
    for name, (parameter, low, high) in _SWEPT.items():
        counted = [
            row["mean"]
            for row in numbers["sweeps"]
            if row["parameter"] == parameter and low <= row["value"] <= high
        ]
        survived = sum(round(config.walks * share) for share in counted)
        found[name] = Interval.of_share(survived, config.walks * len(counted)).scaled(100)
    return found


def judged(config: Config, claim: Claim, values: Sequence[Interval]) -> dict[str, Any]:
    """Values of all seeds, their interval, and the verdict, as `benchmarks.scorecard.claims.judge`.

    One seed has the interval over its walks. Shares of walks of several get Wilson's interval of
    all walks where it is wider: Student's interval over seeds has no width if they are equal.
    """
    each = [value.mean for value in values]
    found = judge(claim, each)
    if found["interval"] is None:
        return found
    if len(values) == 1:
        (own,) = values
        return {**found, "interval": vars(own), "verdict": verdict(claim, each, own)}
    if claim.name not in _SWEPT:
        return found
    parameter, low, high = _SWEPT[claim.name]
    swept = getattr(Sweeps(), SWEEPS[parameter].flag)
    trials = config.walks * sum(low <= value <= high for value in swept)
    survived = sum(round(trials * share / 100) for share in each)
    seeds, walks = (
        Interval.of_row(found["interval"]),
        Interval.of_share(survived, trials * len(each)),
    )
    wide = Interval(
        seeds.mean,
        max(0.0, min(seeds.low, 100 * walks.low)),
        min(100.0, max(seeds.high, 100 * walks.high)),
    )
    return {**found, "interval": vars(wide), "verdict": verdict(claim, each, wide)}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Table of targets: limit, value and verdict."""
    lines = []
    for row in rows:
        claim = Claim(**{key: value for key, value in row.items() if key != "found"})
        found = row["found"]
        lines.append(
            [row["name"], row["measure"], claim.limit, value_text(row, found), found["verdict"]]
        )
    header = ["target", "measured", "limit", "value", "verdict"]
    return markdown(header, lines, ["---", "---", "---:", "---:", "---"])


def table_of_each(record: TargetRecord) -> str:
    """Table of targets: limit, and value of each policy of a record, "-" where it has none."""
    values = record.values()
    rows = [
        [claim.name, claim.limit, *(cell(claim, each[claim.name].mean) for each in values)]
        for claim in TARGETS
    ]
    names = [one["name"] for one in record.policies]
    return markdown(["target", "limit", *names], rows, ["---", *["---:"] * (1 + len(names))])


def cell(claim: Claim, value: float) -> str:
    """Value of a target for one policy as text; "-" for NaN."""
    return f"{value:.{claim.digits}f}" if math.isfinite(value) else "-"


def falls_text(config: Config, found: Sequence[Mapping[str, Interval]]) -> str:
    """Sentence on the falls that were counted, and how many more are likely."""
    counted = {
        "walks at random commands": ("falls, walks", 1e3, config.commands),
        "sudden changes": ("falls, changes", 1e4, config.changes),
    }
    parts = []
    for what, (name, per, each) in counted.items():
        falls, trials = (
            sum(round(values[name].mean * each / per) for values in found),
            each * len(found),
        )
        most = Interval.of_share(falls, trials).high
        parts.append(f"{falls} in {trials} {what} (at most {per * most:.1f} in {per:g})")
    return f"Falls, with upper 95 % limits: {', '.join(parts)}."


def trainings_text(record: TargetRecord) -> str:
    """Sentence on a record's policies, whose trainings should differ in their seed only."""
    made = [
        f"{one['name']} (seed {one['seed']}, {one['commit'] or 'no commit'})"
        for one in record.policies
    ]
    at = ", ".join(sorted({one["measured_at"] or "no commit" for one in record.policies}))
    return (
        f"Policies, with seed and commit of their trainings: {', '.join(made)}. Measured at {at}."
    )


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
