"""Ground-force profiles with one hump and two."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.walking.metrics import (
    dip_ratio,
    force_profile,
    friction_limit_share,
    humps,
    largest_force,
    mean_over_strides,
    touchdown_impact,
)

PERIOD = 0.0005


def stance(first: float, second: float, dip: float, duration: float = 0.6) -> np.ndarray:
    """Force that rises to a hump, falls to a dip, rises to another and ends, smoothly [N]."""
    time = np.arange(round(duration / PERIOD)) * PERIOD / duration
    return PchipInterpolator([0, 0.2, 0.5, 0.8, 1], [0, first, dip, second, 0])(time)


def test_two_humps_and_dip_ratio() -> None:
    force = stance(300.0, 260.0, 91.0)
    np.testing.assert_allclose(humps(force, PERIOD) * PERIOD, [0.12, 0.48], atol=0.01)
    # smoothing takes a little off
    assert dip_ratio(force, PERIOD) == pytest.approx(91 / 260, abs=0.03)


def test_one_hump_has_no_dip() -> None:
    time = np.linspace(0, 1, 1000)
    for force in (400 * np.sin(np.pi * time), np.clip(2000 * np.minimum(time, 1 - time), 0, 380)):
        assert len(humps(force, PERIOD)) == 1
        assert dip_ratio(force, PERIOD) == 1.0


def test_ripples_and_impacts_are_not_humps() -> None:
    time = np.linspace(0, 1, 1000)
    force = 380 * np.sin(np.pi * time) ** 0.5
    rippled = force + 10 * np.sin(2 * np.pi * 8 * time)
    assert len(humps(rippled, PERIOD)) == 1
    struck = force.copy()
    struck[:6] += 900  # 3 ms
    assert len(humps(struck, PERIOD)) == 1


def test_force_profile_is_mean_over_stances() -> None:
    swing = np.zeros(400)
    record = np.concatenate([swing, stance(300, 260, 91), swing, stance(320, 280, 100), swing])
    profile = force_profile(record, PERIOD)
    assert profile.stances == 2
    assert profile.humps == 2
    loaded = (stance(300, 260, 91) > 20).sum(), (stance(320, 280, 100) > 20).sum()
    assert profile.duration == pytest.approx(np.mean(loaded) * PERIOD)
    assert profile.peak == pytest.approx(310.0, abs=1.0)
    assert profile.impulse == pytest.approx(record.sum() * PERIOD / 2, rel=0.01)
    assert 0.3 < profile.dip_ratio < 0.5
    assert np.isnan(force_profile(np.zeros(100), PERIOD).peak)


@pytest.mark.parametrize("speed", [0, 10])
def test_model_humps_have_published_height(library: GaitLibrary, speed: int) -> None:
    """Humps of 433 and 429 N at 0 m/s, 442 and 441 N at 1 m/s, unloaded in between."""
    gait = library.gaits[speed]
    time = np.arange(0, gait.stride, PERIOD)
    force = np.interp(time, gait.time, gait.leg_force[:, 0])
    # from left touchdown on: the left foot is in swing at first
    force = np.roll(force, -int(0.3 * len(force)))
    part = force[int(np.argmax(force > 1)) : len(force) - int(np.argmax(force[::-1] > 1))]
    found = humps(part, PERIOD)
    assert len(found) == 2
    assert dip_ratio(part, PERIOD) < 0.1
    published = {0: (433, 429), 10: (442, 441)}[speed]
    heights = sorted((part[: len(part) // 2].max(), part[len(part) // 2 :].max()))
    np.testing.assert_allclose(heights, sorted(published), atol=1.0)


def test_strides_are_averaged_at_equal_phase() -> None:
    """Two strides of different length and the same shape give that shape."""
    curves = [np.sin(2 * np.pi * np.arange(n) / n) for n in (800, 1000)]
    mean, std = mean_over_strides(np.concatenate([*curves, [0.0]]), np.array([0, 800, 1800]), 100)
    np.testing.assert_allclose(mean, np.sin(2 * np.pi * np.arange(100) / 100), atol=1e-4)
    np.testing.assert_allclose(std, 0.0, atol=1e-4)
    both, _ = mean_over_strides(np.ones((100, 2)) * [1, 2], np.array([0, 50, 99]), 10)
    np.testing.assert_array_equal(both, np.ones((10, 2)) * [1, 2])


def impacts(*peaks: tuple[int, float]) -> np.ndarray:
    """Two stances of 0.3 s with 300 N, and single samples with other forces [N]."""
    force = np.zeros(2000)
    force[200:800] = force[1200:1800] = 300.0
    for sample, value in peaks:
        force[sample] = value
    return force


def test_impact_is_mean_of_largest_forces_after_touchdowns() -> None:
    """Within 50 ms, over body weight."""
    assert touchdown_impact(impacts(), PERIOD, 300.0) == pytest.approx(1.0)
    force = impacts((200, 900.0), (1299, 600.0))
    assert touchdown_impact(force, PERIOD, 300.0) == pytest.approx(2.5)
    force = impacts((300, 900.0), (790, 900.0))  # 50 ms after touchdown, and at the stance's end
    assert touchdown_impact(force, PERIOD, 300.0) == pytest.approx(1.0)
    assert np.isnan(touchdown_impact(np.zeros(2000), PERIOD, 300.0))


def test_largest_force_is_of_one_foot_over_weight() -> None:
    force = np.stack([impacts((500, 750.0)), impacts((300, 600.0))], axis=1)
    assert largest_force(force, 300.0) == pytest.approx(2.5)


def test_friction_limit_share_counts_loaded_feet_near_the_cone() -> None:
    force = np.zeros((8, 2, 3))
    force[:, :, 2] = 200.0
    force[0, 0, 0] = -191.0  # 95.5 % of friction 1
    force[1, 1, :2] = 130.0, 142.0  # 96 %, in two directions
    force[2, 0, 1] = 189.0  # 94.5 %
    force[3, 0] = 19.0, 0.0, 19.0  # unloaded
    assert friction_limit_share(force, 1.0) == 2 / 8
    assert friction_limit_share(force, 2.0) == 0.0
    with pytest.raises(ConfigurationError, match=r"friction must be positive, got 0\.0"):
        friction_limit_share(force, 0.0)
