import numpy as np
import pytest

from aslip.rom.swing import lift, swing_foot, travel

ENDS = np.array([0.0, 1.0])
EPSILON = 1e-9


@pytest.mark.parametrize("profile", [travel, lift])
@pytest.mark.parametrize("order", [1, 2])
def test_foot_rests_at_both_ends(profile, order):
    np.testing.assert_allclose(profile(ENDS, order), 0.0, atol=1e-12)


@pytest.mark.parametrize("ramp", [0.2, 0.35, 0.5])
def test_steady_swing_is_slower_in_the_middle_and_near_the_ground(ramp):
    fraction = np.linspace(0.0, 1.0, 2001)
    share, rate, change = (travel(fraction, order, ramp=ramp) for order in (0, 1, 2))
    np.testing.assert_allclose(share[[0, 1000, 2000]], [0.0, 0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(np.gradient(share, fraction)[1:-1], rate[1:-1], atol=1e-4)
    np.testing.assert_allclose(np.gradient(rate, fraction)[1:-1], change[1:-1], atol=2e-2)
    np.testing.assert_allclose(rate[[0, -1]], 0.0, atol=1e-12)
    np.testing.assert_allclose(change[[0, -1]], 0.0, atol=1e-12)
    steady = (fraction >= ramp) & (fraction <= 1 - ramp)
    np.testing.assert_allclose(rate[steady], rate.max(), rtol=1e-12)
    assert rate.max() == pytest.approx(1 / (1 - ramp))


def test_lift_goes_from_ground_to_clearance_to_ground():
    np.testing.assert_allclose(lift(np.array([0.0, 0.5, 1.0])), [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("order", range(5))
def test_lift_is_four_times_differentiable_at_the_via_point(order):
    """With a via point, least jerk leaves derivatives up to the fourth continuous."""
    below, above = lift(np.array([0.5 - EPSILON, 0.5 + EPSILON]), order)
    assert below == pytest.approx(above, abs=1e-4)


def test_fifth_derivative_jumps_at_the_via_point():
    """The jump is the multiplier of the clearance constraint."""
    below, above = lift(np.array([0.5 - EPSILON, 0.5 + EPSILON]), 5)
    assert below == pytest.approx(-above) and below > 1.0


@pytest.mark.parametrize("profile", [travel, lift])
def test_sixth_derivative_is_zero(profile):
    """Euler-Lagrange equation of least integrated squared jerk."""
    np.testing.assert_array_equal(profile(np.linspace(0.0, 1.0, 11), 6), 0.0)


@pytest.mark.parametrize(
    ("profile", "bump"),
    [
        # zero with two derivatives at the ends; the second one also at the via point
        (travel, np.polynomial.Polynomial.fromroots([0, 0, 0, 1, 1, 1])),
        (lift, np.polynomial.Polynomial.fromroots([0, 0, 0, 0.5, 1, 1, 1])),
        (lift, np.polynomial.Polynomial.fromroots([0, 0, 0, 0.5, 0.5, 1, 1, 1])),
    ],
)
@pytest.mark.parametrize("scale", [-1.0, 1.0])
def test_every_admissible_change_adds_jerk(profile, bump, scale):
    middles = (np.arange(20000) + 0.5) / 20000
    least = np.mean(profile(middles, 3) ** 2)
    changed = np.mean((profile(middles, 3) + scale * bump.deriv(3)(middles)) ** 2)
    added = np.mean(bump.deriv(3)(middles) ** 2)
    # at the optimum the first-order change vanishes
    assert changed - least == pytest.approx(added, rel=1e-4)


def test_foot_velocity_is_the_derivative():
    start, end, step = np.array([0.1, 0.1, 0.0]), np.array([0.9, 0.1, 0.0]), 1e-5
    time = np.linspace(0.05, 0.95, 19) * 0.3
    before, middle, after = (
        swing_foot(time + d, start, end, duration=0.3, clearance=0.2) for d in (-step, 0.0, step)
    )
    difference = (after.position - before.position) / (2 * step)
    np.testing.assert_allclose(middle.velocity, difference, rtol=1e-5, atol=1e-5)


def test_foot_stays_at_its_footholds_outside_the_swing():
    start, end = np.array([0.1, 0.1, 0.0]), np.array([0.9, 0.1, 0.0])
    foot = swing_foot(np.array([-0.15, 0.45]), start, end, duration=0.3, clearance=0.2)
    np.testing.assert_allclose(foot.position, [start, end], atol=1e-15)
    np.testing.assert_array_equal(foot.velocity, 0.0)
