"""Targets of walks over stones: one table of the other benchmarks' numbers, with verdicts.

    python -m benchmarks.scorecard.stone_targets --policy stones
    python -m benchmarks.scorecard.stone_targets --policy runs/seed1 runs/seed2 --record s.json

Random courses are those of difficulty 1: steps of 0.25 to 0.65 m, displaced by up to 10 cm to
either side and up or down. Their seed is another one than that of the recipe's courses. Pushes and
changes of the command are on the floor, where robots follow the library.
Several policies count as seeds of one method, and `--record` keeps the values of each, as in
`benchmarks.scorecard.direction_targets`, whose targets hold on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Directions, check_numbers


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    policy: tuple[str, ...] = ("stones",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""
    out: Path = Path("runs/stone_targets")
    """Folder for the table and results."""
    trials: int = 100
    """Walks over each kind of course."""
    pushes: int = 16
    """Directions of pushes, evenly around the robot."""
    changes: int = 10_000
    """Number of sudden changes of the command."""
    record: Path | None = None
    """File with the values of each policy; its policies count, too."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_numbers(self, trials=1, pushes=1, changes=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Final

from aslip.base.interval import Interval
from aslip.sim.course import PATTERNS
from benchmarks.common import MakeEnv, Policies, Policy, Report, benchmark, policy_name, table
from benchmarks.directions import command_changes
from benchmarks.planning import stepping_stones
from benchmarks.robustness import pushes
from benchmarks.robustness.parameters import SWEEPS
from benchmarks.scorecard import direction_list
from benchmarks.scorecard.direction_targets import COLUMNS
from benchmarks.scorecard.direction_values import impulse_values, training_values
from benchmarks.scorecard.record import ValueRecord, describe, policies_text
from benchmarks.scorecard.verdicts import Claim, verdict_rows


def _completed(name: str, what: str, share: float) -> Claim:
    """Target of a share of courses that are completed."""
    return Claim(name, f"{what}, completed [%]", at_least=share, digits=0)


_ON_FLOOR: Final = {claim.name: claim for claim in direction_list.TARGETS}

TARGETS: Final = (
    replace(_ON_FLOOR["samples"], at_most=10.0),
    replace(_ON_FLOOR["time"], at_most=180.0),
    _completed("20 cm", "random courses of stones of 20 cm", 97.0),
    _completed("30 cm", "random courses of stones of 30 cm", 99.0),
    _completed("15 cm", "random courses of stones of 15 cm", 85.0),
    _completed("patterns", "eight patterns of stones of 20 cm, the worst one", 95.0),
    _completed("stairs, 10 cm", "stairs up and down, the worse ones", 95.0),
    _completed("stairs, 15 cm", "stairs up and down, the worse ones", 90.0),
    _completed("vanishing", "walks on or stops where a stone vanishes", 90.0),
    Claim("feet", "foot from its foothold at touchdown, mean [cm]", at_most=2.0, digits=1),
    Claim("feet, 95 %", "distance that 95 % stay below [cm]", at_most=4.0, digits=1),
    Claim("touchdown", "touchdown before or after its time, mean [ms]", at_most=10.0, digits=0),
    replace(_ON_FLOOR["pushes, least"], at_least=17.0),
    _ON_FLOOR["pushes, mean"],
    _ON_FLOOR["falls, changes"],
)
"""Targets for the nominal robot; feet and touchdowns are those on random courses of 20 cm."""

_NOT_RECORDED: Final = ("policy", "out", "record")


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure; the result is a row for each target."""
    given = [*config.policy] if policies.given is None else [policies.given]
    settings = {k: v for k, v in asdict(config).items() if k not in _NOT_RECORDED}
    record, make_env = ValueRecord(config.record, settings, TARGETS), policies.make_env
    record.measure({"policy": given}, lambda _, one: measure(config, one, make_env), make_env)
    rows = verdict_rows(TARGETS, record.values())
    text = table(COLUMNS, rows, ["---", "---", "---:", "---:", "---"])
    return Report(rows, f"{text}\n\nPolicies: {policies_text(record.policies)}.")


def measure(
    config: Config, policy: Policy, make_env: MakeEnv | None = None
) -> dict[str, float | Interval]:
    """Value of each target for one policy, with intervals over walks."""
    common: dict[str, Any] = {"policy": (policy_name(policy),), "library": config.library}
    common |= {"truth": config.truth, "seed": config.seed}
    out, of = config.out / describe(policy)["name"], (policy, make_env)
    walks = {**common, "trials": config.trials, "difficulties": (1.0,)}
    alone = {"patterns": (), "stairs": (), "vanishing": False}
    rows: dict[str, Any] = {}
    sizes: dict[int, dict[str, Any]] = {20: {}, 30: alone, 15: alone}
    for size, others in sizes.items():
        walks |= {"size": size / 100, "out": out / f"{size}_cm"}
        found = stepping_stones.main(stepping_stones.Config(**walks, **others), *of)
        rows |= {f"{size} cm" if row["course"] == "1" else row["course"]: row for row in found}
    unswept: dict[str, Any] = {sweep.flag: () for sweep in SWEEPS.values()}
    found = pushes.main(pushes.Config(**common, **unswept, out=out, directions=config.pushes), *of)
    robots = min(command_changes.Config.robots, config.changes)
    (changed,) = command_changes.main(
        command_changes.Config(**common, out=out, changes=config.changes, robots=robots), *of
    )
    falls = Interval.of_share(len(changed["falls"]), changed["changes"])
    return {
        **training_values(policy),
        **course_values(rows),
        **impulse_values(found["pushes"]),
        "falls, changes": falls.scaled(1e4),
    }


def course_values(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, float | Interval]:
    """Values of rows of `benchmarks.planning.stepping_stones`, by the name of the course."""
    completed = {name: Interval.of_row(row).scaled(100) for name, row in rows.items()}
    worst = {
        "patterns": PATTERNS,
        "stairs, 10 cm": ("stairs +0.1 m", "stairs -0.1 m"),
        "stairs, 15 cm": ("stairs +0.15 m", "stairs -0.15 m"),
    }
    same = {name: completed[name] for name in ("20 cm", "30 cm", "15 cm", "vanishing")}
    row = rows["20 cm"]
    return {
        **same,
        **{
            name: min((completed[one] for one in of), key=lambda share: share.mean)
            for name, of in worst.items()
        },
        "feet": 100 * row["distance"],
        "feet, 95 %": 100 * row["distance_p95"],
        "touchdown": 1e3 * row["late"],
    }


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
