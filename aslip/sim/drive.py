r"""Joint PD control and the motor's limits, as the robot runs them at 2 kHz (Sec. III-B).

.. math:: \tau = P\,(q^* - q) + D\,(0 - \dot q)

divided by the gear, and limited to what the motor gives at its speed: full torque up to half the
no-load speed, then falling linearly to none. The limit holds for braking too, as in the public
simulator. The simulator's safety clamp on the joint torque (140.63, 140.63, 216.16, 216.16 and
45.14 N m) is left out: the motors give at most 112.5, 112.5, 195.2, 195.2 and 45 N m there, so that
it never acts. The 3 ms torque delay is not here: it is part of the physics state
(`<motor delay=...>` in the model), so that a saved state resumes exactly.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from aslip.robot import (
    GEAR,
    MOTOR_NO_LOAD_SPEED,
    MOTOR_TORQUE_LIMIT,
    PD_DAMPING,
    PD_STIFFNESS,
)

# the joint speed [rad/s] at which a motor gives no torque
_NO_LOAD_JOINT_SPEED = MOTOR_NO_LOAD_SPEED / GEAR
# torque falls from its maximum at half the no-load speed to zero there
_TORQUE_SLOPE = 2.0
_SLOPE = -_TORQUE_SLOPE / _NO_LOAD_JOINT_SPEED


class Drive:
    """PD control and motor limits for n robots, without allocation in the 2 kHz loop.

    Args:
        num: number of robots n.
    """

    def __init__(self, num: int) -> None:
        self._torque = np.empty((num, GEAR.size))

    def torque(
        self,
        target: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque at the motor shafts.

        Args:
            target: (n, 10) joint angles to hold [rad].
            position: (n, 10) joint angles [rad].
            velocity: (n, 10) joint velocities [rad/s].
            out: (n, 10) where to write.

        Returns:
            (n, 10) [N m], overwritten by the next call.
        """
        out = self._torque if out is None else out
        _limited(target, position, velocity, out)
        return out


@njit(nogil=True)
def _limited(
    target: np.ndarray, position: np.ndarray, velocity: np.ndarray, out: np.ndarray
) -> None:
    """PD control and limits; compiled, as twenty NumPy calls a substep cost a fifth of it."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            torque = (target[i, j] - position[i, j]) * PD_STIFFNESS[j]
            torque -= velocity[i, j] * PD_DAMPING[j]
            torque /= GEAR[j]
            # limit = tau_max clip(2 (1 - |w| / w_max), 0, 1)
            limit = abs(velocity[i, j]) * _SLOPE[j] + _TORQUE_SLOPE
            limit = min(max(limit, 0.0), 1.0) * MOTOR_TORQUE_LIMIT[j]
            # written such that what is not a number stays so, and is noticed
            if torque > limit:
                torque = limit
            elif torque < -limit:
                torque = -limit
            out[i, j] = torque


def motor_torque(target: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Torque at the motor shafts of one or many robots; see `Drive.torque`.

    Args:
        target: (..., 10) joint angles to hold [rad].
        position: (..., 10) joint angles [rad].
        velocity: (..., 10) joint velocities [rad/s].

    Returns:
        (..., 10) [N m].
    """
    shape = np.broadcast_shapes(target.shape, position.shape, velocity.shape)
    rows = [np.broadcast_to(x, shape).reshape(-1, GEAR.size) for x in (target, position, velocity)]
    return Drive(rows[0].shape[0]).torque(*rows).reshape(shape)
