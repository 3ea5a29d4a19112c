"""Planted and lifted feet, drift and turn of standing robots."""

import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.walking.metrics import drift, lifted_feet, planting_time, turned

PERIOD = 0.01


def _force(*lifts: tuple[int, int, int]) -> np.ndarray:
    """Force of feet on the ground for 2 s, without a foot from one sample to another."""
    force = np.full((200, 2), 150.0)
    for foot, start, stop in lifts:
        force[start:stop, foot] = 0.0
    return force


@pytest.mark.parametrize(
    ("lifts", "time"),
    [
        ([], 0.0),
        ([(0, 0, 30)], 0.3),
        ([(0, 0, 30), (1, 60, 70)], 0.7),
        ([(0, 0, 30), (1, 85, 95)], 0.3),
        ([(0, 40, 41), (1, 80, 81), (0, 120, 121), (1, 160, 161)], float("nan")),
    ],
)
def test_feet_are_planted_once_both_stay_down(
    lifts: list[tuple[int, int, int]], time: float
) -> None:
    found = planting_time(_force(*lifts), PERIOD)
    np.testing.assert_allclose(found, time, atol=1e-9)


def test_short_records_have_no_planted_feet() -> None:
    assert np.isnan(planting_time(_force()[:49], PERIOD))
    assert planting_time(_force()[:50], PERIOD) == 0.0
    with pytest.raises(ShapeError, match="both feet"):
        planting_time(np.ones(100), PERIOD)


def test_each_time_without_the_ground_counts() -> None:
    assert lifted_feet(_force()) == 0
    assert lifted_feet(_force((0, 10, 20), (1, 15, 30), (0, 50, 51))) == 3
    # a robot that stands on one foot all the time has lifted the other
    assert lifted_feet(_force((0, 0, 200))) == 1


def test_drift_and_turn_begin_at_the_first_sample() -> None:
    place = np.array([[1.0, 2.0, 0.9], [1.03, 2.04, 0.5]])
    np.testing.assert_allclose(drift(place), [0.0, 0.05])
    angle = np.array([3.1, 3.2, 3.3])
    upright = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    np.testing.assert_allclose(turned(upright), [0.0, 0.1, 0.2], atol=1e-9)
