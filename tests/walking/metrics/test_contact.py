"""Contacts of made-up force signals, whose answers are known."""

import numpy as np
import pytest

from aslip.errors import ConfigurationError, ShapeError
from aslip.walking.metrics import (
    airborne_share,
    duty_factor,
    longest_airborne,
    slip_distance,
    stances,
    step_frequency,
    touchdown_times,
)

PERIOD = 0.0005


def square(stride: float, duty: float, offset: float, duration: float, period: float) -> np.ndarray:
    """400 N for a share of each stride, from an offset on."""
    time = np.arange(round(duration / period)) * period
    return np.where((time - offset) % stride / stride < duty, 400.0, 0.0)


def test_stance_edges() -> None:
    force = np.zeros(1000)
    force[200:500] = 300.0
    force[750:900] = 300.0
    np.testing.assert_array_equal(stances(force, PERIOD), [[200, 500], [750, 900]])


def test_incomplete_stances_do_not_count() -> None:
    force = np.full(2000, 300.0)
    force[300:600] = force[1000:1250] = 0.0
    np.testing.assert_array_equal(stances(force, PERIOD), [[600, 1000]])
    assert stances(np.zeros(100), PERIOD).shape == (0, 2)
    assert stances(np.full(100, 300.0), PERIOD).shape == (0, 2)


def test_short_gaps_are_closed_and_short_contacts_dropped() -> None:
    force = np.zeros(2000)
    force[400:1000] = 300.0
    force[420:450] = 0.0  # a bounce of 15 ms on landing
    force[1500:1530] = 300.0  # a scuff of 15 ms
    np.testing.assert_array_equal(stances(force, PERIOD), [[400, 1000]])
    assert len(stances(force, PERIOD, contact=0.0, swing=0.0)) == 3


def test_unloaded_mid_stance_is_one_stance() -> None:
    """Slow spring-mass walking unloads the leg in mid-stance."""
    force = np.zeros(3000)
    force[400:1400] = 300.0
    force[800:1000] = 0.0  # 0.1 s
    force[1800:2800] = 300.0  # after a swing of 0.2 s
    np.testing.assert_array_equal(stances(force, PERIOD), [[400, 1400], [1800, 2800]])
    assert len(stances(force, PERIOD, swing=0.05)) == 3


@pytest.mark.parametrize("period", [0.0005, 0.03])
@pytest.mark.parametrize("stride", [0.8, 0.7646])
def test_step_frequency_is_two_per_stride(period: float, stride: float) -> None:
    left, right = (square(stride, 0.62, offset, 20.0, period) for offset in (0.1, 0.1 + stride / 2))
    assert step_frequency(left, right, period) == pytest.approx(2 / stride, rel=2e-3)


def test_step_frequency_of_uneven_gait_is_its_mean() -> None:
    left, right = (square(0.8, 0.5, offset, 20.0, PERIOD) for offset in (0.0, 0.3))
    assert step_frequency(left, right, PERIOD) == pytest.approx(2.5, rel=1e-3)
    assert np.isnan(step_frequency(np.zeros(100), np.zeros(100), PERIOD))


@pytest.mark.parametrize("duty", [0.5, 0.62, 0.84])
def test_duty_factor_is_stance_share_of_stride(duty: float) -> None:
    assert duty_factor(square(0.8, duty, 0.1, 8.0, PERIOD), PERIOD) == pytest.approx(duty, abs=2e-3)
    assert np.isnan(duty_factor(np.zeros(100), PERIOD))


def test_touchdown_times_are_interpolated() -> None:
    force = np.zeros(100)
    force[50:80] = 100.0  # crosses 20 N a fifth of the way
    np.testing.assert_allclose(touchdown_times(force, 0.03), [(49 + 0.2) * 0.03])


def test_refuses_invalid_force() -> None:
    with pytest.raises(ShapeError, match=r"\(4, 2\)"):
        stances(np.zeros((4, 2)), PERIOD)
    with pytest.raises(ConfigurationError, match="sample 3"):
        stances(np.array([0, 0, 0, np.nan]), PERIOD)
    with pytest.raises(ConfigurationError, match="period"):
        stances(np.zeros(4), 0.0)


def test_duty_factor_divides_by_following_stride() -> None:
    force = np.zeros(3000)
    force[200:400] = force[1000:1300] = 300.0
    assert duty_factor(force, 0.0005) == pytest.approx(200 / 800)


def feet(*spans: tuple[int, int, int]) -> np.ndarray:
    """300 N on a foot for spans of samples of a second: foot, first, one past the last."""
    force = np.zeros((2000, 2))
    for foot, start, stop in spans:
        force[start:stop, foot] = 300.0
    return force


def test_airborne_while_neither_foot_has_force() -> None:
    """In two gaps of 50 and 100 ms, and not while one foot carries the robot."""
    force = feet((0, 0, 800), (1, 900, 1500), (0, 1400, 1600), (1, 1800, 2000))
    assert airborne_share(force) == pytest.approx(300 / 2000)
    assert longest_airborne(force, PERIOD) == pytest.approx(0.1)
    assert airborne_share(force[:800]) == longest_airborne(force[:800], PERIOD) == 0.0
    assert airborne_share(force[1600:1800]) == 1.0
    assert longest_airborne(force[1600:1800], PERIOD) == pytest.approx(0.1)


def sliding(force: np.ndarray, speed: float) -> np.ndarray:
    """Sole that moves at a constant speed at all times, on a line 3 to 4 [m]."""
    displacement = speed * PERIOD * np.arange(len(force))
    return np.stack([0.6 * displacement, -0.8 * displacement, np.zeros(len(force))], axis=1)


def test_slip_is_path_within_stances() -> None:
    """Two stances of 0.2 and 0.3 s at 0.1 m/s; swings and vertical motion do not count."""
    force = feet((0, 200, 600), (0, 1000, 1600))[:, 0]
    foot = sliding(force, 0.1)
    foot[:, 2] = 0.01 * np.sin(np.arange(len(force)))
    assert slip_distance(force, foot, PERIOD) == pytest.approx(0.025, rel=0.01)
    assert slip_distance(force, np.zeros((2000, 3)), PERIOD) == 0.0
    assert np.isnan(slip_distance(np.zeros(2000), foot, PERIOD))


def test_slip_without_contact_does_not_count() -> None:
    """In a gap of 50 ms of a stance."""
    force = feet((0, 200, 1000))[:, 0]
    force[500:600] = 0.0
    foot = np.zeros((2000, 3))
    foot[550:, 0] = 0.02
    assert slip_distance(force, foot, PERIOD) == 0.0
    foot[800:, 0] = 0.03
    assert slip_distance(force, foot, PERIOD) == pytest.approx(0.01)
