"""Sentences of the paper and targets of this project, judged by numbers of several seeds.

    python -m benchmarks.scorecard.claims --baseline single_reference  # shipped policies, one seed
    python -m benchmarks.scorecard.claims --policy runs/seed0 runs/seed1 --paper runs/paper0

Two tables. Sentences of the paper are judged on its settings (`--paper`) and its baseline
(`--baseline`), with the default settings (`--policy`) beside them; targets are judged on the
default settings. A row passes if the whole 95 % interval over seeds meets its limit, fails if the
whole interval misses it or a seed has no value (it fell), and is undecided otherwise. Some rows
demand the limit of each seed. Training costs are read from run folders.

The exit status is 1 if a row that passes in the record (`docs/claims.json`, replaced by `--record`)
now fails or is undecided; one that a single seed misses is not counted.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Compared


@dataclass(frozen=True)
class Config(Compared):
    """Settings of the benchmark."""

    record: bool = False
    """Replace the record."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aslip.base.provenance import provenance
from aslip.base.tables import markdown
from aslip.policy import POLICY_FILE, read_card
from aslip.training.run import write_text
from benchmarks.common import (
    Interval,
    MakeEnv,
    Policy,
    check_straight,
    constant_walks,
    load_subjects,
    policy_name,
    write_results,
)
from benchmarks.paper import foot_placement, ground_force, step_frequency, velocity_tracking
from benchmarks.scorecard.claim_list import SENTENCES, TARGETS, Claim
from benchmarks.scorecard.claim_values import (
    SPEEDS,
    Values,
    correlation_claims,
    foot_claims,
    force_claims,
    largest_by_seed,
    speed_claims,
    training_costs,
)

RECORD = Path("docs/claims.json")
"""Record of the verdicts, and of the policies that they are about."""

COLUMNS: Final = {"paper": "paper's settings", "policy": "default", "baseline": "baseline"}
"""Kind of policies, as a setting of `Config` -> its name in tables."""

# durations of settling and of the correlation [s]
_SETTLE, _WALK = 4.0, 8.0


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> int:
    """Measure, print and write; returns the number of rows that passed and no longer pass.

    Args:
        config: the settings.
        policy: policy to measure in place of `config.policy`.
        make_env: function that makes the environment of `policy`, see `benchmarks.common`.

    Raises:
        ConfigurationError: a policy follows gaits in all directions.
    """
    policies: dict[str, list[Policy]] = {kind: [*getattr(config, kind)] for kind in COLUMNS}
    if policy is not None:
        policies["policy"] = [policy]
    check_straight([one for ones in policies.values() for one in ones])
    values = measure(config, policy, make_env)
    rows = judged_rows(values)
    about = {kind: [describe(one) for one in ones] for kind, ones in policies.items()}
    numbers = {"made_by": provenance(), "policies": about, **rows}
    write_results(config.out, "claims", numbers, report(rows, about))
    lost = lost_claims(rows, read_record())
    for name in lost:
        print(f"no longer passes: {name}")
    if config.record:
        write_record(rows, about)
    return len(lost)


# ---------------------------------------------------------------------- values


def measure(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> dict[str, Values]:
    """Run the benchmarks; returns kind of policies -> claim -> value of each seed.

    Pictures and tables of the benchmarks are written to a folder for each kind.
    """
    values: dict[str, Values] = {}
    if config.policy or policy is not None:
        values["policy"] = measure_kind(config, "policy", policy, make_env)
    if config.paper:
        values["paper"] = measure_kind(config, "paper")
    settings = {name: getattr(config, name) for name in ("truth", "seed", "out", *COLUMNS)}
    rows = ground_force.main(ground_force.Config(**settings), policy, make_env)
    for kind, forces in force_claims(rows).items():
        values[kind] = {**values.get(kind, {}), **forces}
    return values


def measure_kind(
    config: Config, kind: str, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> Values:
    """Values of claims about one kind of policies, except for ground forces."""
    common: dict[str, Any] = {"policy": getattr(config, kind), "truth": config.truth}
    common |= {"seed": config.seed, "out": config.out / kind}
    of = (policy, make_env)
    settings = foot_placement.Config(**common)
    walks = constant_walks(settings, load_subjects(settings, *of), SPEEDS, _SETTLE + _WALK)
    frequencies = step_frequency.main(step_frequency.Config(**common), *of)
    off = [[100 * abs(off) for off in row["each"]] for row in frequencies]
    return {
        **training_costs(common["policy"] if policy is None else [policy]),
        **speed_claims(velocity_tracking.main(velocity_tracking.Config(**common), *of)),
        **foot_claims(foot_placement.main(settings, *of)),
        **correlation_claims(walks, _SETTLE),
        "step frequency": largest_by_seed(off),
    }


# -------------------------------------------------------------------- verdicts


def judged_rows(values: Mapping[str, Values]) -> dict[str, list[dict[str, Any]]]:
    """Rows of both tables: the claim, and values and verdict of each kind that it is about."""

    def row(claim: Claim, kinds: Sequence[str]) -> dict[str, Any]:
        found = {kind: judge(claim, values.get(kind, {}).get(claim.name, ())) for kind in kinds}
        return {**vars(claim), "limit": claim.limit, "found": found}

    return {
        "sentences": [
            row(claim, ["baseline"] if claim.on_baseline else ["paper", "policy"])
            for claim in SENTENCES
        ],
        "targets": [row(claim, ["policy"]) for claim in TARGETS],
    }


def judge(claim: Claim, each: Sequence[float]) -> dict[str, Any]:
    """Values of all seeds, their interval, and the verdict on them."""
    each = [float(value) for value in each]
    finite = bool(np.isfinite(each).all())
    mean = Interval.of([np.array([value]) for value in each]) if each and finite else None
    return {"each": each, "interval": mean and vars(mean), "verdict": verdict(claim, each, mean)}


def verdict(claim: Claim, each: Sequence[float], interval: Interval | None) -> str:
    """Verdict on the values of all seeds.

    Args:
        claim: the claim.
        each: value of each seed.
        interval: their mean and interval, of one seed over its walks; None if a seed has no value.
    """
    if not each:
        return "not measured"
    if interval is None:
        return "FAIL"
    ends = each if claim.every_seed else (interval.low, interval.high)
    met = [claim.is_met(value) for value in ends]
    if len(each) == 1:
        word = "met" if all(met) else "undecided" if any(met) else "missed"
        return f"{word} by one seed"
    if all(met):
        return "PASS"
    # a limit is one-sided: an interval with both ends outside misses it as a whole
    return "FAIL" if claim.every_seed or not any(met) else "undecided"


# ---------------------------------------------------------------------- tables


def report(
    rows: Mapping[str, Sequence[dict[str, Any]]], about: Mapping[str, Sequence[Mapping[str, Any]]]
) -> str:
    """Both tables, the counts of verdicts of each, and the policies."""
    sentences, targets = rows["sentences"], rows["targets"]
    counted = [
        f"{COLUMNS[kind]}: {count_text(sentences, kind)}"
        for kind in ("paper", "policy", "baseline")
    ]
    named = "\n".join(f"- {COLUMNS[kind]}: {policies_text(about[kind])}" for kind in COLUMNS)
    return "\n\n".join(
        [
            sentence_table(sentences),
            f"Sentences of the paper, {'; '.join(counted)}.",
            target_table(targets),
            f"Targets, {COLUMNS['policy']}: {count_text(targets, 'policy')}.",
            "95 % intervals of the mean over seeds; lowest and highest seed where each seed has to"
            f" meet the limit.\n\n{named}",
        ]
    )


def sentence_table(rows: Sequence[dict[str, Any]]) -> str:
    """Table of the paper's sentences, judged on its settings, with the default beside."""
    cells = []
    for row in rows:
        ours = " (ours)" if row["ours"] else ""
        texts = [row["name"], row["sentence"], row["measure"], row["published"], row["released"]]
        cells.append([*texts, row["limit"] + ours, *value_cells(row)])
    header = [
        "claim", "sentence of the paper", "measured here", "published", "released policies",
        "limit", "paper's settings", "verdict", "default", "verdict on the default",
    ]  # fmt: skip
    return markdown(header, cells, [*["---"] * 3, *["---:"] * 4, "---", "---:", "---"])


def value_cells(row: dict[str, Any]) -> list[str]:
    """Value and verdict on the paper's settings, and on the default."""
    found = row["found"]
    if row["on_baseline"]:
        text = value_text(row, found["baseline"])
        return [f"baseline: {text}" if text else "", found["baseline"]["verdict"], "", ""]
    paper, default = found["paper"], found["policy"]
    fed = " (an input)" if row["fed_forward"] and default["each"] else ""
    return [
        value_text(row, paper), paper["verdict"],
        value_text(row, default), default["verdict"] + fed,
    ]  # fmt: skip


def target_table(rows: Sequence[dict[str, Any]]) -> str:
    """Table of targets, judged on the default settings."""
    cells = [
        [
            row["name"], row["measure"], row["published"], row["released"], row["limit"],
            value_text(row, row["found"]["policy"]), row["found"]["policy"]["verdict"],
        ]
        for row in rows
    ]  # fmt: skip
    header = [
        "target", "measured here", "published", "released policies", "limit (ours)", "default",
        "verdict",
    ]  # fmt: skip
    return markdown(header, cells, [*["---"] * 2, *["---:"] * 4, "---"])


_OF_ONE_SEED = ("met by one seed", "missed by one seed", "undecided by one seed")


def value_text(row: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """Mean over seeds as text, with the interval or, if each seed counts, with the extremes."""
    each, digits = found["each"], row["digits"]
    if not each:
        return ""
    if found["interval"] is None:
        return f"no value for {np.count_nonzero(~np.isfinite(each))} of {len(each)} seeds"
    if row["every_seed"] and len(each) > 1:
        low, high = (f"{value:.{digits}f}" for value in (min(each), max(each)))
        return low if low == high else f"{np.mean(each):.{digits}f} ({low} to {high})"
    return Interval.of_row(found["interval"]).text(digits)


def count_text(rows: Sequence[Mapping[str, Any]], kind: str) -> str:
    """Number of rows of each verdict on one kind of policies."""
    verdicts = [row["found"][kind]["verdict"] for row in rows if kind in row["found"]]
    count = Counter(verdicts)
    order = ("PASS", "FAIL", "undecided", *_OF_ONE_SEED, "not measured")
    return ", ".join(f"{count[name]} {name}" for name in order if count[name])


def policies_text(policies: Sequence[Mapping[str, Any]]) -> str:
    """Names, seeds, commits and budgets of policies."""
    texts = []
    for one in policies:
        facts = [f"seed {one['seed']}" if one["seed"] is not None else ""]
        facts += [f"commit {one['commit']}" if one["commit"] else ""]
        facts += [f"{one['steps'] / 1e6:.2f} million policy steps" if one["steps"] else ""]
        known = ", ".join(fact for fact in facts if fact)
        texts.append(f"`{one['name']}`" + (f" ({known})" if known else ""))
    return ", ".join(texts) or "none"


# ---------------------------------------------------------------------- record


def describe(policy: Policy) -> dict[str, Any]:
    """Name of a policy without its folder, and seed, commit and policy steps of its training."""
    about: dict[str, Any] = {"seed": None, "commit": None, "steps": None}
    if not isinstance(policy, str | Path):
        return {"name": policy_name(policy), **about}
    made = read_card(policy).get("made_by", {})
    about |= {"commit": made.get("commit"), "steps": made.get("steps")}
    path = Path(policy).resolve()
    path = path.parent if path.name == POLICY_FILE else path
    return {
        "name": path.name.removesuffix(".zip"),
        **about,
        "seed": made.get("settings", {}).get("seed"),
    }


def write_record(
    rows: Mapping[str, Sequence[dict[str, Any]]], about: Mapping[str, Sequence[Mapping[str, Any]]]
) -> None:
    """Write the record: verdicts of both tables, and policies with seeds and commits."""
    verdicts = {
        table: {
            row["name"]: {kind: found["verdict"] for kind, found in row["found"].items()}
            for row in of_table
        }
        for table, of_table in rows.items()
    }
    kept = {"commit": provenance()["commit"], "policies": about, **verdicts}
    write_text(RECORD, json.dumps(kept, indent=1) + "\n")


def read_record() -> dict[str, dict[str, dict[str, str]]]:
    """Read the verdicts of the record, table -> claim -> kind; empty without a record."""
    kept = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    return {table: kept.get(table, {}) for table in ("sentences", "targets")}


def lost_claims(
    rows: Mapping[str, Sequence[dict[str, Any]]], record: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    """Rows that pass in the record, and are judged now without passing."""
    return [
        f"{row['name']} ({COLUMNS[kind]})"
        for table, of_table in rows.items()
        for row in of_table
        for kind, found in row["found"].items()
        if record.get(table, {}).get(row["name"], {}).get(kind) == "PASS"
        and found["verdict"] in ("FAIL", "undecided")
    ]


if __name__ == "__main__":
    with one_line_errors():
        raise SystemExit(min(main(CONFIG), 1))
