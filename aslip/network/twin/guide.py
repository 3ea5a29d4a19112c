"""Guide of a simulated robot: stones and commands, in the datagrams that a runner listens to."""

from __future__ import annotations

import json
import socket

import numpy as np

from aslip.base.checks import check_number
from aslip.network.wire import LOOPBACK
from aslip.network.wire.endpoint import check_port
from aslip.robot.rotation import rotate_level, yaw
from aslip.sim.course import Course, along_course

# distance from the pelvis within which stones are seen [m]
_SIGHT = 2.5


class Guide:
    """Guide of a simulated robot over a course.

    Its datagrams are those of `aslip.network.runner.commands.Datagrams`: the stones around the
    pelvis, in their true places, and a command along the course.

    Args:
        course: course, whose frame is the world's.
        port: port on loopback at which the runner listens.
        speed: forward speed [m/s].

    Raises:
        ConfigurationError: there is no such port, or the speed is not from 0 to 2 m/s.
    """

    def __init__(self, course: Course, port: int, speed: float = 0.5) -> None:
        check_port(port)
        self.course, self.speed = course, check_number("speed", speed, 0.0, 2.0)
        self._address = (LOOPBACK, port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, position: np.ndarray, orientation: np.ndarray) -> None:
        """Send what a robot sees with its pelvis at a position (3,) [m] and orientation (4,)."""
        # nobody may listen yet
        self._socket.sendto(json.dumps(self.message(position, orientation)).encode(), self._address)

    def message(self, position: np.ndarray, orientation: np.ndarray) -> dict[str, object]:
        """Entries of a datagram, see `send`."""
        turn = yaw(orientation)
        place, speed = position[None, :2], np.array([[self.speed]])
        command = along_course(self.course.stones[None], place, np.array([[turn]]), speed)[0]
        stones = []
        for corners, row in zip(self.course.corners, self.course.stones, strict=True):
            if np.linalg.norm(row[:2] - position[:2]) <= _SIGHT:
                level = rotate_level(corners - position[:2], -turn)
                height = np.full((len(level), 1), row[2] - position[2])
                stones.append(np.concatenate([level, height], 1).round(6).tolist())
        names = ("forward", "sideways", "yaw_rate")
        return {**dict(zip(names, command.tolist(), strict=True)), "stones": stones}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
