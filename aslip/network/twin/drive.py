"""Low-level PD control whose commands contain feedforward, targets and gains, as on the robot."""

from __future__ import annotations

import numpy as np

from aslip.base.compiled import compiled
from aslip.network.wire import MotorCommand
from aslip.sim import Drive


class CommandedPD(Drive):
    r"""PD control with the feedforward, targets and gains of a command.

    .. math:: \tau = \tau_{ff} + P\,(q^* - q) + D\,(\dot q^* - \dot q)

    A command (n, 5 m) contains the five vectors of `aslip.network.wire.MotorCommand`. Zeros leave
    the motors without torque; zero position gains with positive velocity gains damp the robot.
    Without feedforward and target velocity, torques equal those of `aslip.sim.PD` bit for bit.
    """

    @property
    def command_size(self) -> int:
        """Size of a command, five numbers per motor."""
        return len(MotorCommand._fields) * super().command_size

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]."""
        torque = np.empty_like(position)
        _feedback(command, position, velocity, torque)
        return torque


@compiled
def _feedback(
    command: np.ndarray, position: np.ndarray, velocity: np.ndarray, out: np.ndarray
) -> None:
    """Write torques of (n, m) joints for commands (n, 5 m), fields as `MotorCommand`, to `out`."""
    m = position.shape[1]
    for i in range(position.shape[0]):
        for j in range(m):
            torque = (command[i, m + j] - position[i, j]) * command[i, 3 * m + j]
            torque += (command[i, 2 * m + j] - velocity[i, j]) * command[i, 4 * m + j]
            out[i, j] = torque + command[i, j]
