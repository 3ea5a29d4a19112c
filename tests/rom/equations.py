"""Equations of motion of the actuated SLIP, written anew in NumPy."""

import numpy as np


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
