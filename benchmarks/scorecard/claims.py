"""Sentences of the paper and targets of this project, tested on several seeds.

    python -m benchmarks.scorecard.claims --baseline single_reference  # shipped policies, one seed
    python -m benchmarks.scorecard.claims --policy runs/seed0 runs/seed1 --paper runs/paper0

Two tables. Sentences of the paper are tested on its settings (`--paper`) and its baseline
(`--baseline`), with those of `straight` (`--policy`) beside them; targets are tested on
`straight`. A row passes if the whole 95 % interval over seeds meets its limit, fails if the
whole interval misses it or a seed has no value (it fell), and is undecided otherwise. Some rows
demand the limit of each seed. Training costs are read from run folders.

With `--record`, the values of each policy are kept in a file. Its policies are not measured again,
and the tables are over all of them: after an interruption, the same command continues.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Common


@dataclass(frozen=True)
class Config(Common):
    """Settings of the benchmark."""

    paper: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py paper`."""
    baseline: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py single_reference`."""
    record: Path | None = None
    """File with the values of each policy; its policies count, too."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common import Policies, Policy, Report, Subject, benchmark, table
from benchmarks.paper.ground_force import check_straight
from benchmarks.scorecard.paper_list import SENTENCES, TARGETS
from benchmarks.scorecard.paper_values import measure
from benchmarks.scorecard.record import ValueRecord, policies_text
from benchmarks.scorecard.verdicts import KINDS, count_text, value_text, verdict_rows

Rows = list[dict[str, Any]]


@benchmark
def main(config: Config, policies: Policies) -> Report[dict[str, Rows]]:
    """Measure; the result is the rows of both tables.

    Raises:
        ConfigurationError: a policy follows gaits in all directions, or see `ValueRecord`.
        FileDamagedError: the file given as record holds no values of policies.
    """
    kinds: dict[str, list[Policy]] = {kind: [*getattr(config, kind)] for kind in KINDS}
    if policies.given is not None:
        kinds["policy"] = [policies.given]
    check_straight([Subject.load(one) for ones in kinds.values() for one in ones])
    settings = {"truth": config.truth, "seed": config.seed}
    record = ValueRecord(config.record, settings, [*SENTENCES, *TARGETS])
    made = {"policy": policies.make_env}
    record.measure(
        kinds, lambda kind, one: measure(config, kind, one, made.get(kind)), policies.make_env
    )
    values = record.values()
    rows = {"sentences": verdict_rows(SENTENCES, values), "targets": verdict_rows(TARGETS, values)}
    return Report(rows, report(rows, record.policies), None, {"policies": record.policies, **rows})


def report(rows: Mapping[str, Rows], policies: Sequence[Mapping[str, Any]]) -> str:
    """Both tables, the counts of verdicts of each, and the policies."""
    sentences, targets = rows["sentences"], rows["targets"]
    counted = [f"{name}: {count_text(sentences, kind)}" for kind, name in KINDS.items()]
    named = [
        f"- {name}: {policies_text([one for one in policies if one['kind'] == kind])}"
        for kind, name in KINDS.items()
    ]
    return "\n\n".join(
        [
            table(SENTENCE_COLUMNS, sentences, [*["---"] * 3, *["---:"] * 4, "---", "---:", "---"]),
            f"Sentences of the paper, {'; '.join(counted)}.",
            table(TARGET_COLUMNS, targets, [*["---"] * 2, *["---:"] * 4, "---"]),
            f"Targets, {KINDS['policy']}: {count_text(targets, 'policy')}.",
            "95 % intervals of the mean over seeds; lowest and highest seed where each seed has to"
            " meet the limit.",
            "\n".join(named),
        ]
    )


def _first(row: Mapping[str, Any]) -> str:
    """Kind of policies on which a sentence is tested."""
    return "baseline" if row["on_baseline"] else "paper"


def _first_value(row: Mapping[str, Any]) -> str:
    """Value on the kind of policies on which a sentence is tested."""
    text = value_text(row, _first(row))
    return f"baseline: {text}" if text and row["on_baseline"] else text


def _verdict_on_straight(row: Mapping[str, Any]) -> str:
    """Verdict on `straight`; empty for a sentence about the baseline."""
    if row["on_baseline"]:
        return ""
    found = row["found"]["policy"]
    return found["verdict"] + (" (an input)" if row["fed_forward"] and found["each"] else "")


_FACTS = {
    "measured here": "{measure}",
    "published": "{published}",
    "released policies": "{released}",
}

SENTENCE_COLUMNS = {
    "claim": "{name}",
    "sentence of the paper": "{sentence}",
    **_FACTS,
    "limit": lambda row: row["limit"] + (" (ours)" if row["ours"] else ""),
    "paper's settings": _first_value,
    "verdict": lambda row: row["found"][_first(row)]["verdict"],
    "straight": lambda row: "" if row["on_baseline"] else value_text(row),
    "verdict on straight": _verdict_on_straight,
}

TARGET_COLUMNS = {
    "target": "{name}",
    **_FACTS,
    "limit (ours)": "{limit}",
    "straight": value_text,
    "verdict": "{found[policy][verdict]}",
}


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
