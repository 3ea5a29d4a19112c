"""Claims, and verdicts on the values that policies have for them.

A claim passes if the whole 95 % interval over seeds meets its limit. It fails if the whole interval
misses it, or if a seed has no value because it fell, and is undecided otherwise. Some claims demand
the limit of each seed. One seed alone is "met", "missed" or "undecided", no verdict.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aslip.base.interval import Interval

KINDS = {"paper": "paper's settings", "policy": "straight", "baseline": "baseline"}
"""Kind of policies -> its name in tables."""

_OF_ONE_SEED = ("met by one seed", "missed by one seed", "undecided by one seed")
_VERDICTS = ("PASS", "FAIL", "undecided", *_OF_ONE_SEED, "not measured")

Values = Mapping[str, Interval]
"""Value of each claim for one policy, with its interval over walks; NaN after a fall."""


@dataclass(frozen=True)
class Claim:
    """Sentence or target: the quantity that is measured for it, and the limit of its value."""

    name: str
    """Name in tables and in the record."""
    measure: str
    """Quantity that is measured, with its unit, and its difference from the paper's quantity."""
    sentence: str = ""
    """Sentence of the paper with its section; empty for a target of this project."""
    published: str = ""
    """Value in the paper or its figures; empty without one."""
    released: str = ""
    """Values of the policies that the paper's authors released; empty without any."""
    at_least: float = -math.inf
    """Smallest value that meets the claim."""
    at_most: float = math.inf
    """Largest value that meets the claim."""
    strict: bool = False
    """True if the limit itself does not meet the claim."""
    every_seed: bool = False
    """True if each seed has to meet the limit, in place of the interval over seeds."""
    ours: bool = True
    """True if the limit is this project's, False if it is the paper's number."""
    fed_forward: bool = False
    """True if `straight` feeds the quantity forward: an input there, not a result."""
    on_baseline: bool = False
    """True for a sentence about the single-reference baseline."""
    digits: int = 2
    """Digits of the value in tables."""

    @property
    def limit(self) -> str:
        """Limit as text."""
        if math.isfinite(self.at_least):
            return f"{'>' if self.strict else '≥'} {self.at_least:g}"
        return f"{'<' if self.strict else '≤'} {self.at_most:g}"

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of policies that it is about."""
        if self.on_baseline:
            return ("baseline",)
        return ("paper", "policy") if self.sentence else ("policy",)

    def is_met(self, value: float) -> bool:
        """Whether a value is within the limit."""
        if self.strict:
            return self.at_least < value < self.at_most
        return self.at_least <= value <= self.at_most


def verdict_rows(
    claims: Sequence[Claim],
    values: Mapping[str, Sequence[Values]],
    walks: Mapping[str, int] | None = None,
) -> list[dict[str, Any]]:
    """Rows of a table: the claim, and under "found" values and verdict of each kind of policies.

    A claim has a verdict only if every policy of the kind has a value for it.

    Args:
        claims: the claims.
        values: kind of policies -> values of each policy.
        walks: name of a share of walks [%] -> number of walks of a policy, see `verdict`.
    """
    rows = []
    for claim in claims:
        found = {}
        for kind in claim.kinds:
            of_kind = values.get(kind, ())
            known = all(claim.name in one for one in of_kind)
            of_claim = [one[claim.name] for one in of_kind] if known else []
            found[kind] = verdict(claim, of_claim, (walks or {}).get(claim.name, 0))
        rows.append({**vars(claim), "limit": claim.limit, "found": found})
    return rows


def verdict(claim: Claim, values: Sequence[Interval], walks: int = 0) -> dict[str, Any]:
    """Values of all seeds, their interval, and the verdict on them.

    One seed has the interval over its walks. Shares of walks of several get Wilson's interval of
    all walks where it is wider: Student's interval over seeds has no width if they are equal.

    Args:
        claim: the claim.
        values: value of each seed.
        walks: number of walks of a seed, of which the values are shares [%]; 0 for other values.
    """
    each = [value.mean for value in values]
    interval = None
    if each and np.isfinite(each).all():
        interval = values[0]
        if len(each) > 1:
            interval = Interval.of([np.array([value]) for value in each])
            if walks:
                interval = _widened(interval, each, walks)
    text = _verdict_text(claim, each, interval)
    return {"each": each, "interval": interval and vars(interval), "verdict": text}


def _widened(interval: Interval, each: Sequence[float], walks: int) -> Interval:
    """Interval of shares [%] over seeds, at least as wide as Wilson's of all walks."""
    survived = sum(round(walks * share / 100) for share in each)
    wilson = Interval.of_share(survived, walks * len(each)).scaled(100)
    low, high = min(interval.low, wilson.low), max(interval.high, wilson.high)
    return Interval(interval.mean, max(0.0, low), min(100.0, high))


def _verdict_text(claim: Claim, each: Sequence[float], interval: Interval | None) -> str:
    """Verdict on the values of all seeds; the interval is None if a seed has no value."""
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


def value_text(row: Mapping[str, Any], kind: str = "policy") -> str:
    """Mean over seeds as text, with the interval or, if each seed counts, with the extremes."""
    found, digits = row["found"][kind], row["digits"]
    each = found["each"]
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
    count = Counter(row["found"][kind]["verdict"] for row in rows if kind in row["found"])
    return ", ".join(f"{count[name]} {name}" for name in _VERDICTS if count[name])
