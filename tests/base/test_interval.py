"""Means and shares with 95 % intervals."""

import math

import numpy as np
import pytest

from aslip.base.interval import Interval


def test_interval_over_seeds_or_values() -> None:
    several = Interval.of([np.array([1.0, 3.0]), np.array([4.0])])
    assert several.mean == 3.0
    assert several.high - several.mean == pytest.approx(12.706 * 1.0, rel=1e-3)
    alone = Interval.of([np.random.default_rng(0).normal(size=400)])
    assert alone.high - alone.low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert math.isnan(Interval.of([np.array([np.nan])]).mean)
    few = Interval.of([np.array([1.0, 2.0, 6.0])])
    assert few == Interval(3.0, 3.0, 3.0)


def test_interval_ignores_nonfinite_values() -> None:
    """NaN values are left out of their group; the others count."""
    some = [np.array([1.0, np.nan, 3.0]), np.array([np.nan]), np.array([4.0, np.inf])]
    assert Interval.of(some) == Interval.of([np.array([1.0, 3.0]), np.array([4.0])])


@pytest.mark.parametrize("groups", [[np.full(20, 0.1)], [np.array([0.1])] * 3])
def test_interval_of_equal_values_is_empty(groups: list[np.ndarray]) -> None:
    """Exactly, otherwise tables would show an interval."""
    assert Interval.of(groups) == Interval(0.1, 0.1, 0.1)


@pytest.mark.parametrize(
    ("successes", "low", "high"), [(0, 0.0, 0.2775), (5, 0.2366, 0.7634), (10, 0.7225, 1.0)]
)
def test_wilsons_interval(successes: int, low: float, high: float) -> None:
    """For ten trials, from published tables."""
    interval = Interval.of_share(successes, 10)
    assert interval.mean == successes / 10
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-4)


def test_wilsons_interval_contains_the_proportion() -> None:
    """Rounding must not exclude it, as plots need low <= mean <= high."""
    for count in range(1, 80):
        for successes in range(count + 1):
            interval = Interval.of_share(successes, count)
            assert 0 <= interval.low <= interval.mean <= interval.high <= 1
