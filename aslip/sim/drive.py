r"""Low level at 2 kHz: from a command to torques of the motors, within their limits (Sec. III-B).

`PD` is what the paper has,

.. math:: \tau = P\,(q^* - q) + D\,(0 - \dot q),

and `Torque` takes torques at the joints as they come. Both are divided by the gear, and limited to
what the motor gives at its speed: full torque up to half the no-load speed, then falling linearly
to none. The limit holds for braking too, as in the public simulator.

The simulator's safety clamp on the joint torque (140.63, 140.63, 216.16, 216.16 and 45.14 N m) is
left out: the motors give at most 112.5, 112.5, 195.2, 195.2 and 45 N m there, so that it never
acts. The 3 ms torque delay is not here: it is part of the physics state (`<motor delay=...>` in the
model), so that a saved state resumes exactly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

import numpy as np

from aslip.robot import CASSIE, Robot
from aslip.robot.compiled import compiled
from aslip.sim.parameters import DRIVE

# torque falls from its maximum at half the no-load speed to zero there
_TORQUE_SLOPE = 2.0


class Drive(ABC):
    """Low level of n robots; a subclass says what joint torque a command asks for.

    Args:
        num: number of robots n.
        robot: robot with m motors, whose gear and limits apply.
    """

    def __init__(self, num: int, robot: Robot = CASSIE) -> None:
        self._gear, self._limit = robot.gear, robot.torque_limit
        # change of the limit's share with the joint's speed [s/rad]
        self._slope = -_TORQUE_SLOPE / (robot.no_load_speed / robot.gear)
        self._torque = np.empty((num, robot.gear.size))

    @property
    def command_size(self) -> int:
        """Numbers in a robot's command; one a motor by default."""
        return self._gear.size

    def torque(
        self,
        command: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque at the motor shafts.

        Args:
            command: (n, `command_size`).
            position: (n, m) joint angles [rad].
            velocity: (n, m) joint velocities [rad/s].
            out: (n, m) array to write into.

        Returns:
            (n, m) [N m], overwritten by the next call.
        """
        out = self._torque if out is None else out
        torque = self.joint_torque(command, position, velocity)
        _limited(torque, velocity, self._gear, self._slope, self._limit, out)
        return out

    def write_gains(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Write the gains among the fields of `aslip.sim.Dynamics` of (k,) robots; none here."""
        del ids, fields

    @abstractmethod
    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]; see `torque`."""

    def initial_command(self, position: np.ndarray) -> np.ndarray:
        """Command (n, `command_size`) of robots at rest at (n, m) joint angles; zero by default."""
        return np.zeros((len(position), self.command_size))


MakeDrive = Callable[[int, Robot], Drive]
"""Class of a drive, or a function of the number of robots and the robot that makes one."""


class PD(Drive):
    """Proportional-derivative control; a command is (n, m) joint angles to hold [rad].

    Args:
        num: number of robots n.
        robot: robot with m motors, whose gains, gear and limits apply.
    """

    def __init__(self, num: int, robot: Robot = CASSIE) -> None:
        super().__init__(num, robot)
        self.stiffness = np.tile(robot.stiffness, (num, 1))
        """(n, m) position gains at the joints [N m/rad]."""
        self.damping = np.tile(robot.damping, (num, 1))
        """(n, m) velocity gains at the joints [N m s/rad]."""

    def torque(
        self,
        command: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque at the motor shafts; see `Drive.torque`."""
        out = self._torque if out is None else out
        _pd_limited(
            command, position, velocity, self.stiffness, self.damping,
            self._gear, self._slope, self._limit, out,
        )  # fmt: skip
        return out

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]."""
        return (command - position) * self.stiffness - velocity * self.damping

    def write_gains(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Write the gains among the fields of `aslip.sim.Dynamics` of (k,) robots."""
        for name, gains in (("stiffness", self.stiffness), ("damping", self.damping)):
            if DRIVE + name in fields:
                gains[ids] = fields[DRIVE + name]

    def initial_command(self, position: np.ndarray) -> np.ndarray:
        """Angles at which the robots are."""
        return position.copy()


class Torque(Drive):
    """Feedforward torque; a command is (n, m) torques at the joints [N m]."""

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]."""
        del position, velocity
        return command


# compiled: twenty NumPy calls a substep cost a fifth of it
@compiled
def _pd_limited(
    target: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    gear: np.ndarray,
    slope: np.ndarray,
    most: np.ndarray,
    out: np.ndarray,
) -> None:
    """PD control and limits of (n, m) motors."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            torque = (target[i, j] - position[i, j]) * stiffness[i, j]
            torque -= velocity[i, j] * damping[i, j]
            out[i, j] = _limit(torque / gear[j], velocity[i, j], slope[j], most[j])


@compiled
def _limited(
    torque: np.ndarray,
    velocity: np.ndarray,
    gear: np.ndarray,
    slope: np.ndarray,
    most: np.ndarray,
    out: np.ndarray,
) -> None:
    """Shaft torques within the limits, from (n, m) joint torques."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _limit(torque[i, j] / gear[j], velocity[i, j], slope[j], most[j])


@compiled
def _limit(torque: float, velocity: float, slope: float, most: float) -> float:
    """Torque of a motor within its limit at a joint velocity.

    The limit is most clip(2 (1 - |w| / w_max), 0, 1). A torque that is not a number stays so, and
    is noticed.
    """
    limit = min(max(abs(velocity) * slope + _TORQUE_SLOPE, 0.0), 1.0) * most
    if torque > limit:
        return limit
    if torque < -limit:
        return -limit
    return torque
