"""Claims have verdicts on the values of several seeds."""

import math

import pytest

from aslip.base.interval import Interval
from benchmarks.common import table
from benchmarks.scorecard import direction_list, direction_targets
from benchmarks.scorecard.paper_list import SENTENCES, TARGETS
from benchmarks.scorecard.verdicts import Claim, verdict, verdict_rows

DIRECTIONS = direction_list.TARGETS
ALL = {claim.name: claim for claim in (*SENTENCES, *TARGETS, *DIRECTIONS)}


def seeds(*values: float) -> list[Interval]:
    """Values of seeds, without intervals of their own."""
    return [Interval(value, value, value) for value in values]


@pytest.mark.parametrize("claims", [(*SENTENCES, *TARGETS), DIRECTIONS])
def test_no_claim_is_listed_twice_and_each_has_one_limit(claims: tuple[Claim, ...]) -> None:
    assert len({claim.name for claim in claims}) == len(claims)
    assert all(math.isinf(claim.at_least) != math.isinf(claim.at_most) for claim in claims)
    sentences = [claim.sentence[:3] for claim in claims if claim.sentence]
    assert {*sentences} <= {"V: ", "V-A", "V-B", "Fig"}
    assert len(sentences) in (0, len(SENTENCES))


def test_sentences_on_feet_need_more_than_zero() -> None:
    """Wider feet and lagging feet, as the sentences say."""
    for name, value in (("wider feet", 0.1), ("feet lag", -0.1)):
        assert not ALL[name].is_met(0.0)
        assert ALL[name].is_met(value)
    assert ALL["feet to 1.0 m/s"].is_met(3.0)
    assert verdict(ALL["wider feet"], seeds(0.0, 0.0))["verdict"] == "FAIL"


@pytest.mark.parametrize(
    ("each", "expected"),
    [
        ([], "not measured"),
        ([0.4], "met by one seed"),
        ([0.7], "missed by one seed"),
        ([math.nan], "FAIL"),
        ([0.40, 0.41, 0.39], "PASS"),
        ([0.40, 0.41, 0.58], "undecided"),  # each seed below the limit, the interval not
        ([0.7, 0.71, 0.69], "FAIL"),
        ([0.40, 0.41, math.inf], "FAIL"),
        ([0.5, 0.5], "PASS"),
    ],
)
def test_verdict_by_interval_over_seeds(each: list[float], expected: str) -> None:
    assert verdict(Claim("any", "x", at_most=0.5 + 0.1), seeds(*each))["verdict"] == expected
    mirrored = Claim("any", "x", at_least=-0.6)
    assert verdict(mirrored, seeds(*(-value for value in each)))["verdict"] == expected


def test_verdict_by_each_seed() -> None:
    """One seed that misses fails the row, one far within the limit does not blur it."""
    claim = Claim("humps", "x", at_most=0.7, every_seed=True)
    for each, expected in (([0.1, 0.69, 0.68], "PASS"), ([0.3, 0.3, 0.3, 0.3, 0.8], "FAIL")):
        assert verdict(claim, seeds(*each))["verdict"] == expected
    assert verdict(claim, seeds(0.1))["verdict"] == "met by one seed"


def test_shares_of_walks_have_an_interval_if_all_seeds_are_equal() -> None:
    """Wilson's lower limit is 97.7 % if 160 of 160 walks survive, and above 98 % for 400 of 400."""
    claim = ALL["motors"]
    few, many = (verdict(claim, seeds(*[100.0] * count), 80) for count in (2, 5))
    assert few["interval"]["low"] == pytest.approx(97.66, abs=0.01)
    assert few["interval"]["high"] == few["interval"]["mean"] == 100.0
    assert [few["verdict"], many["verdict"]] == ["undecided", "PASS"]
    spread = verdict(claim, seeds(100.0, 96.25), 80)["interval"]  # Student's is wider
    assert (spread["low"], spread["high"]) == (pytest.approx(74.3, abs=0.1), 100.0)


@pytest.mark.parametrize(
    ("name", "values", "shown"),
    [
        ("path", seeds(4.0, 5.0), "≤ 10 | 4.5 [-1.9, 10.9] | undecided |"),
        ("path", seeds(4.0, math.nan), "≤ 10 | no value for 1 of 2 seeds | FAIL |"),
        ("falls, walks", seeds(0.0, 5.0), "≤ 0 | 2 (0 to 5) | FAIL |"),
        # one seed has the interval of its walks
        (
            "velocity, 95 %",
            [Interval(0.053, 0.042, 0.07)],
            "≤ 0.06 | 0.053 [0.042, 0.070] | undecided by one seed |",
        ),
        ("falls, walks", [Interval(0.0, 0.0, 18.8)], "≤ 0 | 0 [0, 19] | met by one seed |"),
        ("drift", seeds(1.4), "≤ 1 | 1.40 | missed by one seed |"),
    ],
)
def test_a_row_has_limit_value_and_verdict(name: str, values: list[Interval], shown: str) -> None:
    rows = verdict_rows([ALL[name]], {"policy": [{name: value} for value in values]})
    assert table(direction_targets.COLUMNS, rows).endswith(shown)


def test_a_claim_that_a_seed_lacks_has_no_verdict() -> None:
    values = [{"drift": one} for one in seeds(0.1, 0.2)]
    (row,) = verdict_rows([ALL["drift"]], {"policy": [*values, {}]})
    assert row["found"]["policy"] == {"each": [], "interval": None, "verdict": "not measured"}
