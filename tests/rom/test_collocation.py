import casadi as ca
import numpy as np
import pytest

from aslip.rom import collocation

INTERVALS, H = 4, 0.3
TIME = np.linspace(0.0, INTERVALS * H, 2 * INTERVALS + 1)


def polynomial(degree):
    return np.polynomial.Polynomial(np.arange(1.0, degree + 2.0))


@pytest.mark.parametrize("degree", range(4))
def test_cubic_states_have_no_defect(degree):
    x = polynomial(degree)
    gaps = collocation.defects(ca.DM(x(TIME)).T, ca.DM(x.deriv()(TIME)).T, H)
    np.testing.assert_allclose(gaps.full(), 0.0, atol=1e-12)


def test_quartic_states_end_exactly_but_miss_the_midpoint():
    x = polynomial(4)
    gaps = collocation.defects(ca.DM(x(TIME)).T, ca.DM(x.deriv()(TIME)).T, H).full()
    np.testing.assert_allclose(gaps[1], 0.0, atol=1e-12)
    # the error term of cubic Hermite interpolation: x'''' h^4 / 384
    np.testing.assert_allclose(gaps[0], x.deriv(4)(0.0) * H**4 / 384, rtol=1e-10)


@pytest.mark.parametrize("degree", range(4))
def test_integrals_of_cubics_are_exact(degree):
    f = polynomial(degree)
    exact = f.integ()(TIME[-1]) - f.integ()(0.0)
    assert H * collocation.weights(INTERVALS) @ f(TIME) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5, 1.0])
def test_input_parabola_is_exact(fraction):
    f = polynomial(2)
    values = f(np.array([[0.0, 0.5, 1.0]]))
    assert collocation.quadratic(values, fraction)[0] == pytest.approx(f(fraction), rel=1e-14)
