"""Energy of the actuated SLIP, an oracle for its dynamics."""

import casadi as ca

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
