r"""Low level at 2 kHz: commands to motor torques within the motors' limits (Sec. III-B).

`PD` is the paper's control law,

.. math:: \tau = P\,(q^* - q) + D\,(0 - \dot q),

and the command of `Torque` is the joint torque itself. The gear divides the torque, and the motor
limits it: full torque up to half the no-load speed, then a linear decrease to zero at the no-load
speed. The limit holds for braking, too, as in the public simulator.

The simulator also clamps joint torques at 140.63, 140.63, 216.16, 216.16 and 45.14 N m. This clamp
is left out because it never acts: the motors give at most 112.5, 112.5, 195.2, 195.2 and 45 N m.
The torque delay of 3 ms is part of the physics state (`<motor delay=...>` in the model), so that a
saved state resumes exactly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

import numpy as np

from aslip.base.compiled import compiled
from aslip.robot import CASSIE, Robot
from aslip.sim.parameters import DRIVE

# the limit falls from its maximum at half the no-load speed to zero at the no-load speed
_TORQUE_SLOPE = 2.0


class Drive(ABC):
    """Low level of n robots; a subclass implements `joint_torque`.

    Args:
        num: number of robots n.
        robot: robot with m motors; gives gear and motor limits.
    """

    def __init__(self, num: int, robot: Robot = CASSIE) -> None:
        self._gear, self._limit = robot.gear, robot.torque_limit
        # change of limit / largest torque with the joint's speed [s/rad]
        self._slope = -_TORQUE_SLOPE / (robot.no_load_speed / robot.gear)
        self._torque = np.empty((num, robot.gear.size))

    @property
    def command_size(self) -> int:
        """Size of a robot's command; by default the number of motors."""
        return self._gear.size

    def torque(
        self,
        command: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque at the motor shafts, within the motors' limits.

        Args:
            command: (n, `command_size`) commands.
            position: (n, m) joint angles [rad].
            velocity: (n, m) joint velocities [rad/s].
            out: (n, m) array for the result.

        Returns:
            (n, m) torques [N m]; the next call overwrites them.
        """
        out = self._torque if out is None else out
        torque = self.joint_torque(command, position, velocity)
        _limited(torque, velocity, self._gear, self._slope, self._limit, out)
        return out

    def write_gains(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Set the gains of (k,) robots from fields of `aslip.sim.Dynamics`; here there are none."""
        del ids, fields

    @abstractmethod
    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]; arguments as in `torque`."""

    def initial_command(self, position: np.ndarray) -> np.ndarray:
        """Command (n, `command_size`) after a reset to (n, m) joint angles; zero by default."""
        return np.zeros((len(position), self.command_size))


MakeDrive = Callable[[int, Robot], Drive]
"""Subclass of `Drive`, or function of number of robots and `Robot` that makes a drive."""


class PD(Drive):
    """Proportional-derivative control; commands are (n, m) target angles of the joints [rad].

    Args:
        num: number of robots n.
        robot: robot with m motors; gives gains, gear and motor limits.
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
        """Set the gains of (k,) robots from fields of `aslip.sim.Dynamics`."""
        for name, gains in (("stiffness", self.stiffness), ("damping", self.damping)):
            if DRIVE + name in fields:
                gains[ids] = fields[DRIVE + name]

    def initial_command(self, position: np.ndarray) -> np.ndarray:
        """Present joint angles, as a copy."""
        return position.copy()


class Torque(Drive):
    """Torque control; commands are (n, m) torques at the joints [N m]."""

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        """Torque (n, m) at the joints before the motors' limits [N m]."""
        del position, velocity
        return command


# compiled: NumPy calls would take a fifth of a substep
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
    """Write PD torques of (n, m) motors within their limits to `out`."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            torque = (target[i, j] - position[i, j]) * stiffness[i, j]
            torque -= velocity[i, j] * damping[i, j]
            out[i, j] = motor_limit(torque / gear[j], velocity[i, j], slope[j], most[j])


@compiled
def _limited(
    torque: np.ndarray,
    velocity: np.ndarray,
    gear: np.ndarray,
    slope: np.ndarray,
    most: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write shaft torques within the limits, from (n, m) joint torques, to `out`."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = motor_limit(torque[i, j] / gear[j], velocity[i, j], slope[j], most[j])


@compiled
def motor_limit(torque: float, velocity: float, slope: float, most: float) -> float:
    """Torque of a motor within its limit at a joint velocity.

    The limit is most clip(2 (1 - |w| / w_max), 0, 1). NaN stays NaN, so that the simulation
    diverges and is reset.
    """
    limit = min(max(abs(velocity) * slope + _TORQUE_SLOPE, 0.0), 1.0) * most
    if torque > limit:
        return limit
    if torque < -limit:
        return -limit
    return torque
