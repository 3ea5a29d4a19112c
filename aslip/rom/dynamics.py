r"""Actuated SLIP in CasADi: a point mass on two massless legs with springs and set points.

State, 10 numbers: body position :math:`\mathbf r` (3) [m] and velocity (3) [m/s] in the world frame
(x forward, y left, z up, ground at z = 0), set points :math:`d_l, d_r` [m], their rates [m/s].
Input, 2 numbers: actuator accelerations :math:`u_l, u_r` [m/s^2]. Left always precedes right.
"""

from functools import cache

import casadi as ca

from aslip.rom.slip import Mode, SlipParameters, leg_force

STATE_SIZE = 10
"""Length of the state: body position, body velocity, two set points, two set-point rates."""
CONTROL_SIZE = 2
"""Length of the input: acceleration of the left and of the right actuator."""


def leg_axis(body: ca.SX, velocity: ca.SX, foot: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Leg length [m], its rate [m/s] and the unit vector from foot to body (3, 1), world frame.

    Args:
        body: body position (3, 1) [m].
        velocity: body velocity (3, 1) [m/s].
        foot: foot position (3, 1) [m]; a foot on the ground does not move.
    """
    leg = body - foot
    length = ca.norm_2(leg)
    axis = leg / length
    return length, ca.dot(axis, velocity), axis


@cache
def leg_function(p: SlipParameters) -> ca.Function:
    """CasADi function (state, left foot, right foot) -> (leg forces (2,) [N], lengths (2,) [m]).

    Both legs are treated as in stance; the caller discards the values of a swing leg.
    """
    state, feet = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("feet", 3, 2)
    force, length = ca.SX(2, 1), ca.SX(2, 1)
    for leg in range(2):
        length[leg], rate, _ = leg_axis(state[:3], state[3:6], feet[:, leg])
        force[leg] = leg_force(length[leg], rate, state[6 + leg], state[8 + leg], p)
    return ca.Function("legs", [state, feet[:, 0], feet[:, 1]], [force, length])


@cache
def flow_function(mode: Mode, p: SlipParameters) -> ca.Function:
    r"""CasADi function (state, input, left foot, right foot) -> time derivative of the state.

    .. math::
        m\,\ddot{\mathbf r} = \sum_\text{stance} F_i\,\mathbf n_i - m\,g\,\mathbf e_z, \qquad
        I_m\,\ddot d_i = I_m\,u_i - F_i \text{ in stance}, \quad \ddot d_i = u_i \text{ in swing}

    Paper says u is the acceleration of the leg actuator and lists I_m without an equation. The
    published gaits show the equation above: over a stance d'' + F / I_m is nearly constant and d''
    is not, so the spring force acts back on the actuator. A swing leg carries no force.
    """
    state, control = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", CONTROL_SIZE)
    feet = ca.SX.sym("feet", 3, 2)
    force, _ = leg_function(p)(state, feet[:, 0], feet[:, 1])
    acceleration = ca.SX([0.0, 0.0, -p.gravity])
    actuator = ca.SX(control)
    for leg, on_ground in enumerate(mode.stance):
        if on_ground:
            _, _, axis = leg_axis(state[:3], state[3:6], feet[:, leg])
            acceleration += force[leg] / p.mass * axis
            actuator[leg] -= force[leg] / p.actuator_inertia
    derivative = ca.vertcat(state[3:6], acceleration, state[8:10], actuator)
    return ca.Function(f"flow_{mode.name}", [state, control, feet[:, 0], feet[:, 1]], [derivative])
