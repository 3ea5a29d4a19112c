"""Cost and smoothness of a walk."""

from __future__ import annotations

import numpy as np

from aslip.robot import CASSIE, STANDARD_GRAVITY


def cost_of_transport(
    torque: np.ndarray,
    velocity: np.ndarray,
    distance: float,
    period: float,
    *,
    mass: float = CASSIE.total_mass,
) -> float:
    r"""Mechanical cost of transport.

    .. math:: \frac{\int \sum_i |\tau_i \omega_i|\,dt}{m g d}

    Negative power counts as cost, too (no recuperation). NaN without distance.

    Args:
        torque: (m, 10) joint torques [N m].
        velocity: (m, 10) joint velocities [rad/s].
        distance: distance covered [m].
        period: time between samples [s].
        mass: mass of the robot [kg].
    """
    work = float(np.abs(torque * velocity).sum() * period)
    return work / (mass * STANDARD_GRAVITY * distance) if distance > 0 else float("nan")


def action_roughness(action: np.ndarray) -> float:
    """Root mean square of the change of action from one policy step to the next [rad].

    The norm is over motors, as in the paper's `action_diff` reward.

    Args:
        action: (m, 10) actions [rad].
    """
    return float(np.sqrt(np.mean(np.sum(np.diff(action, axis=0) ** 2, axis=1))))


def jerk(velocity: np.ndarray, period: float) -> float:
    """Root mean square of the second difference of a velocity over time squared [m/s^3].

    Args:
        velocity: (m, ...) velocity, time first [m/s].
        period: time between samples [s].
    """
    return float(np.sqrt(np.mean(np.square(np.diff(velocity, n=2, axis=0)))) / period**2)
