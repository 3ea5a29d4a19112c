import casadi as ca
import numpy as np
import pytest

from aslip.rom import Mode, SlipParameters
from aslip.rom.dynamics import flow_function, leg_function
from aslip.rom.slip import leg_force

from .laws import energy_function

P = SlipParameters()
FEET = np.array([0.15, 0.1, 0.0]), np.array([-0.15, -0.1, 0.0])


@pytest.fixture
def state():
    rng = np.random.default_rng(0)
    rest = np.array([0.0, 0.0, 0.85, 1.0, 0.0, 0.0, 0.95, 0.95, 0.0, 0.0])
    return rest + 0.05 * rng.standard_normal(10)


@pytest.fixture
def control():
    return np.array([12.0, -7.0])


def test_leg_force_is_spring_plus_damper():
    """F = k (d - l) + b (d' - l'): 10 cm short and closing at 0.5 m/s is 300 N + 1 N."""
    assert leg_force(0.8, -0.4, 0.9, 0.1, P) == pytest.approx(301.0)


def test_leg_force_vanishes_when_leg_follows_its_set_point():
    assert leg_force(0.9, 0.3, 0.9, 0.3, P) == 0.0


@pytest.mark.parametrize("mode", Mode)
def test_jacobian_of_the_dynamics_agrees_with_finite_differences(mode, state, control):
    flow, point, step = flow_function(mode, P), np.r_[state, control], 1e-6
    z = ca.SX.sym("z", 12)
    jacobian = ca.Function("J", [z], [ca.jacobian(flow(z[:10], z[10:], *FEET), z)])(point).full()

    def at(z):
        return flow(z[:10], z[10:], *FEET).full().ravel()

    differences = [(at(point + e) - at(point - e)) / (2 * step) for e in step * np.eye(12)]
    np.testing.assert_allclose(jacobian, np.transpose(differences), rtol=1e-6, atol=1e-6)


def test_swing_leg_carries_no_force_and_its_actuator_obeys_its_input(state, control):
    flow = flow_function(Mode.RIGHT, P)
    moved = state + np.eye(10)[6] * 0.1
    difference = (flow(moved, control, *FEET) - flow(state, control, *FEET)).full().ravel()
    np.testing.assert_array_equal(difference, 0.0)
    assert float(flow(state, control, *FEET)[8]) == control[0]


def test_spring_pushes_back_on_the_actuator_in_stance(state, control):
    force = leg_function(P)(state, *FEET)[0].full().ravel()
    derivative = flow_function(Mode.DOUBLE, P)(state, control, *FEET).full().ravel()
    np.testing.assert_allclose(P.actuator_inertia * (control - derivative[8:]), force, rtol=1e-12)


def test_body_obeys_newton(state, control):
    forces = leg_function(P)(state, *FEET)[0].full().ravel()
    axes = [(state[:3] - foot) / np.linalg.norm(state[:3] - foot) for foot in FEET]
    total = forces @ np.array(axes) - [0.0, 0.0, P.mass * 9.81]
    derivative = flow_function(Mode.DOUBLE, P)(state, control, *FEET).full().ravel()
    np.testing.assert_allclose(derivative[3:6], total / 30.0, rtol=1e-12)


@pytest.mark.parametrize("mode", Mode)
def test_power_balance_holds_at_any_state(mode, state, control):
    """dE/dt along the flow is actuator power minus damper loss."""
    energy, flow = energy_function(mode, P), flow_function(mode, P)
    x = ca.SX.sym("x", 10)
    slope = ca.Function("dE", [x], [ca.gradient(energy(x, control, *FEET)[0], x)])(state)
    _, supplied, lost = energy(state, control, *FEET)
    change = float(ca.dot(slope, flow(state, control, *FEET)))
    assert change == pytest.approx(float(supplied - lost), rel=1e-10)
