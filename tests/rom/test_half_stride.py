import casadi as ca
import numpy as np
import pytest

from aslip.rom import SlipParameters
from aslip.rom.certificate import KKT_TOLERANCE
from aslip.rom.certify import certify, kkt_residual, rows
from aslip.rom.half_stride import fold, half_stride_problem

STEP = 1e-6


@pytest.fixture(scope="module")
def problem():
    return half_stride_problem(SlipParameters())


@pytest.fixture(scope="module")
def point(problem, gait):
    """Variables of the gait at 1 m/s, moved a little off the optimum."""
    problem.start_from(fold(gait))
    x = problem.opti.debug.value(problem.opti.x, problem.opti.initial())
    return x + 1e-3 * np.random.default_rng(0).standard_normal(x.size)


def directional(problem, output, point, direction):
    """Value of the output along a direction, and its exact directional derivative."""
    opti = problem.opti
    along = ca.jtimes(output, opti.x, ca.DM(direction))
    f = ca.Function("f", [opti.x, opti.p], [output, along])
    return (lambda x: f(x, 1.0)[0].full().ravel()), f(point, 1.0)[1].full().ravel()


@pytest.mark.parametrize("name", ["f", "g"])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_given_to_ipopt_agree_with_finite_differences(problem, point, name, seed):
    direction = np.random.default_rng(seed).standard_normal(point.size)
    value, exact = directional(problem, getattr(problem.opti, name), point, direction)
    change = value(point + STEP * direction) - value(point - STEP * direction)
    np.testing.assert_allclose(exact, change / (2 * STEP), rtol=1e-5, atol=1e-5)


def test_every_constraint_row_has_a_name(problem):
    assert sum(count for _, count in problem.constraints) == problem.opti.ng
    assert list(rows(problem)) == [name for name, _ in problem.constraints]


def test_kkt_residual_is_zero_at_a_known_optimum():
    """For x^2 with 1 <= x: x = 1, multiplier -2."""
    one = np.ones(1)
    assert kkt_residual(2 * one - 2 * one, one, one, np.inf * one, -2 * one) == 0.0


@pytest.mark.parametrize(
    ("gradient", "g", "lam", "expected"),
    [(0.5, 1.0, -2.0, 0.5), (0.0, 0.7, 0.0, 0.3), (0.0, 1.5, -2.0, 1.0), (0.0, 1.0, 2.0, 2.0)],
    ids=["not stationary", "infeasible", "not complementary", "wrong sign"],
)
def test_kkt_residual_detects_each_violation(gradient, g, lam, expected):
    arrays = (np.array([v]) for v in (gradient, g, 1.0, np.inf, lam))
    assert kkt_residual(*arrays) == pytest.approx(expected)


def test_multipliers_of_inactive_bounds_fail_the_certificate(monkeypatch):
    """Complementarity: after bounds move away by 0.1, their multipliers belong to no bound."""
    problem, speed = half_stride_problem(SlipParameters(), "mean"), 1.0
    problem.opti.set_value(problem.command, speed)
    problem.start_from(problem.rough_guess(speed))
    problem.opti.solve()
    half = problem.solution()
    assert certify(problem, half, np.array([speed]), 0.0).kkt_residual <= KKT_TOLERANCE
    optimality, lam = problem.optimality, np.ravel(problem.opti.value(problem.opti.lam_g))

    def moved(*args):
        gradient, g, lower, upper = optimality(*args)
        return 0 * gradient, g, lower - 0.1, upper + 0.1

    monkeypatch.setitem(vars(problem), "optimality", moved)
    certificate = certify(problem, half, np.array([speed]), 0.0)
    assert certificate.kkt_residual == pytest.approx(0.1 * np.abs(lam).max(), rel=1e-3)
    assert certificate.kkt_residual > 1e-2
    assert not certificate.ok
