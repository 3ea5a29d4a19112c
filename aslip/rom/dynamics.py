r"""Actuated SLIP in CasADi: a point mass on two massless legs with springs and set points.

State, 10 numbers: body position :math:`\mathbf r` (3) [m] and velocity (3) [m/s] in the world frame
(x forward, y left, z up, ground at z = 0), set points :math:`d_l, d_r` [m], their rates [m/s].
Input, 2 numbers: actuator accelerations :math:`u_l, u_r` [m/s^2]. Left always precedes right.
"""

from enum import IntEnum
from functools import cache
from typing import Any

import casadi as ca

from aslip.rom.parameters import SlipParameters

STATE_SIZE = 10
"""Length of the state: body position, body velocity, two set points, two set-point rates."""
CONTROL_SIZE = 2
"""Length of the input: acceleration of the left and of the right actuator."""


class Mode(IntEnum):
    """Contact mode: which feet are on the ground."""

    LEFT = 0
    RIGHT = 1
    DOUBLE = 2

    @property
    def stance(self) -> tuple[bool, bool]:
        """Whether the left and the right foot are on the ground."""
        return self is not Mode.RIGHT, self is not Mode.LEFT


def leg_force(
    length: Any, length_rate: Any, set_point: Any, set_point_rate: Any, p: SlipParameters
) -> Any:
    r"""Axial force of one leg [N], positive when it pushes the body away from the foot.

    .. math:: F = k\,(d - \ell) + b\,(\dot d - \dot\ell)

    Spring and damper of Green et al. 2021, Table I. Plain arithmetic: floats, NumPy arrays and
    CasADi expressions of any one shape are accepted.

    Args:
        length: leg length l, foot to body [m].
        length_rate: its rate [m/s].
        set_point: actuator set point d [m].
        set_point_rate: its rate [m/s].
        p: model parameters.

    Returns:
        Force in the shape of the inputs [N].
    """
    return p.stiffness * (set_point - length) + p.damping * (set_point_rate - length_rate)


def leg_axis(body: ca.SX, velocity: ca.SX, foot: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Length [m], its rate [m/s] and the unit vector from foot to body (3, 1), world frame.

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

    Both legs are taken to be on the ground; the caller drops the one that is not.
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
    published gaits show what is meant: the spring pushes back on the actuator inertia in stance,
    for it is d'' + F / I_m, not d'', that is nearly constant over a stance. A swing leg carries no
    force.
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


def energy_function(mode: Mode, p: SlipParameters) -> ca.Function:
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
