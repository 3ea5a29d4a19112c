"""Low level that takes feedforward, targets and gains with every command, as the robot does."""

from __future__ import annotations

import numpy as np

from aslip.sim import Drive
from aslip.wire import MotorCommand


class CommandedPD(Drive):
    r"""PD control with targets and gains of the command.

    .. math:: \tau = \tau_{ff} + P\,(q^* - q) + D\,(\dot q^* - \dot q)

    A command holds the five vectors of `aslip.wire.MotorCommand`, (n, 5 m). All zero leaves the
    motors without torque; zero position gains with positive velocity gains damp the robot. Without
    feedforward and target velocity, torques equal those of `aslip.sim.PD` bit for bit.
    """

    @property
    def command_size(self) -> int:
        """Five numbers per motor."""
        return len(MotorCommand._fields) * super().command_size

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]."""
        c = MotorCommand(*np.split(command, len(MotorCommand._fields), axis=1))
        feedback = (c.position - position) * c.stiffness + (c.velocity - velocity) * c.damping
        return feedback + c.torque
