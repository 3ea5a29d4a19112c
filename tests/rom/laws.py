"""Energy and equations of motion of the actuated SLIP, written anew; derivatives by differences."""

import casadi as ca
import numpy as np

from aslip.rom.dynamics import CONTROL_SIZE, STATE_SIZE, leg_axis


def energy_function(mode, p):
    r"""CasADi function (state, input, left foot, right foot) -> (energy, power in, power lost).

    .. math::
        E = \tfrac12 m\,\dot{\mathbf r}^2 + m\,g\,z + \sum_i \tfrac12 I_m\,\dot d_i^2
            + \sum_\text{stance} \tfrac12 k\,(d_i - \ell_i)^2, \qquad
        \dot E = \sum_i I_m\,u_i\,\dot d_i - \sum_\text{stance} b\,(\dot d_i - \dot\ell_i)^2

    Energy in [J], actuator power and damper loss in [W].
    """
    state, control = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", CONTROL_SIZE)
    feet, rates = ca.SX.sym("feet", 3, 2), state[8:10]
    energy = p.mass * (ca.sumsqr(state[3:6]) / 2 + p.gravity * state[2])
    energy += p.actuator_inertia * ca.sumsqr(rates) / 2
    lost = ca.SX(0)
    for leg, on_ground in enumerate(mode.stance):
        if on_ground:
            length, rate, _ = leg_axis(state[:3], state[3:6], feet[:, leg])
            energy += p.stiffness * (state[6 + leg] - length) ** 2 / 2
            lost += p.damping * (rates[leg] - rate) ** 2
    supplied = p.actuator_inertia * ca.dot(control, rates)
    arguments = [state, control, feet[:, 0], feet[:, 1]]
    return ca.Function(f"energy_{mode.name}", arguments, [energy, supplied, lost])


def derivative(state, control, feet, mode, p):
    """Derivative (10,) of a state (10,) with inputs (2,) and feet (2, 3)."""
    force, actuator = np.array([0.0, 0.0, -p.weight]), control.copy()
    for leg in (leg for leg in range(2) if mode.stance[leg]):
        lever = state[:3] - feet[leg]
        length = np.sqrt(lever @ lever)
        spring = p.stiffness * (state[6 + leg] - length)
        along = spring + p.damping * (state[8 + leg] - lever @ state[3:6] / length)
        force += along * lever / length
        actuator[leg] -= along / p.actuator_inertia
    return np.concatenate([state[3:6], force / p.mass, state[8:10], actuator])


def check_velocities(gait, atol):
    """Assert that sampled velocities are derivatives of the positions, within `atol` [m/s]."""
    step = 1e-6
    phase = np.linspace(0.003, 0.997, 200)
    before, middle, after = (gait.sample(phase + d) for d in (-step, 0.0, step))
    for name in ("body", "feet"):
        ends = getattr(before, name).position, getattr(after, name).position
        difference = (ends[1] - ends[0]) / (2 * step * gait.stride)
        np.testing.assert_allclose(getattr(middle, name).velocity, difference, atol=atol)
