"""Cost and smoothness of a walk."""

from __future__ import annotations

import numpy as np

from aslip.errors import ShapeError


def mechanical_power(torque: np.ndarray, velocity: np.ndarray) -> float:
    r"""Mean positive mechanical power of the motors [W].

    .. math:: \frac{1}{T} \int \sum_i \max(\tau_i \omega_i, 0)\,dt

    Braking motors neither cost nor recover power, and heat in the windings does not count.

    Args:
        torque: (m, 10) torques of the motors at the joints [N m].
        velocity: (m, 10) velocities of these joints [rad/s].

    Raises:
        ShapeError: the arrays are not of the same motors and samples, or empty.
    """
    if torque.shape != velocity.shape or torque.ndim != 2 or not len(torque):
        raise ShapeError(
            f"torque and velocity must both be (m, motors), got {torque.shape}, {velocity.shape}"
        )
    return float(np.maximum(torque * velocity, 0.0).sum(axis=1).mean())


def cost_of_transport(power: float, weight: float, speed: float) -> float:
    r"""Specific mechanical cost of transport, power over weight and speed.

    Defined with the positive mechanical power of the actuators (`mechanical_power`): Collins,
    Ruina, Tedrake and Wisse, "Efficient Bipedal Robots Based on Passive-Dynamic Walkers", Science
    307 (2005). NaN without forward speed.

    Args:
        power: mean positive mechanical power [W].
        weight: weight of the robot [N].
        speed: mean forward speed [m/s].
    """
    return power / (weight * speed) if speed > 0 else float("nan")


def action_roughness(action: np.ndarray) -> float:
    """Root mean square of the change of action from one policy step to the next [rad].

    The norm is over motors, as in the paper's `action_diff` reward.

    Args:
        action: (m, 10) actions [rad].
    """
    return float(np.sqrt(np.mean(np.sum(np.diff(action, axis=0) ** 2, axis=1))))
