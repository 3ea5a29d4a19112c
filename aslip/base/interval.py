"""Means and shares with 95 % confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

CONFIDENCE: Final = 0.95
"""Confidence of all intervals."""

_RESAMPLES = 2000
# fewer values make a bootstrap too narrow
_LEAST_VALUES = 10


@dataclass(frozen=True)
class Interval:
    """Mean and its 95 % confidence interval."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, groups: Sequence[np.ndarray]) -> Interval:
        """Mean over groups (seeds) of their finite values.

        Several groups get Student's interval over their means. A single group gets a bootstrap
        interval over its values, or none with fewer than ten.
        """
        kept = [group[np.isfinite(group)] for group in map(np.asarray, groups)]
        kept = [group for group in kept if len(group)]
        if not kept:
            return cls(np.nan, np.nan, np.nan)
        means = np.array([group.mean() for group in kept])
        mean = float(means.mean())
        values = means if len(means) > 1 else kept[0]
        if np.ptp(values) == 0:
            mean = float(values[0])  # without rounding errors
            return cls(mean, mean, mean)
        if len(means) > 1:
            from scipy import stats  # slow to import

            half = stats.t.ppf(0.5 + CONFIDENCE / 2, len(means) - 1) * stats.sem(means)
            return cls(mean, mean - float(half), mean + float(half))
        return cls(mean, *_resampled(values, lambda drawn: drawn.mean(axis=1)))

    @classmethod
    def of_quantile(cls, values: np.ndarray, share: float) -> Interval:
        """Quantile of finite values in place of the mean, with a bootstrap interval."""
        if not len(values):
            return cls(np.nan, np.nan, np.nan)
        ends = _resampled(values, lambda drawn: np.quantile(drawn, share, axis=1))
        return cls(float(np.quantile(values, share)), *ends)

    @classmethod
    def of_share(cls, successes: int, trials: int) -> Interval:
        """Share of successes with Wilson's interval, valid at 0 and 1, too."""
        from scipy import stats  # slow to import

        found = stats.binomtest(successes, trials)
        interval = found.proportion_ci(CONFIDENCE, method="wilson")
        return cls(successes / trials, float(interval.low), float(interval.high))

    def scaled(self, factor: float) -> Interval:
        """Interval in another unit."""
        return Interval(factor * self.mean, factor * self.low, factor * self.high)

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> Interval:
        """Interval from a row with its fields."""
        return cls(row["mean"], row["low"], row["high"])

    def text(self, digits: int, scale: float = 1.0) -> str:
        """Mean times `scale`, with the interval if it is not empty."""
        mean, low, high = (f"{scale * v:.{digits}f}" for v in (self.mean, self.low, self.high))
        return mean if self.low == self.high else f"{mean} [{low}, {high}]"


def _resampled(
    values: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray]
) -> tuple[float, float]:
    """Ends of a bootstrap interval; with fewer than ten values it is empty.

    Args:
        values: (n,) values.
        statistic: function of resamples (m, n) that returns (m,).
    """
    if len(values) < _LEAST_VALUES:
        (value,) = statistic(values[None])
        return float(value), float(value)
    rng = np.random.default_rng(0)
    drawn = statistic(rng.choice(values, (_RESAMPLES, len(values))))
    low, high = np.quantile(drawn, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return float(low), float(high)
