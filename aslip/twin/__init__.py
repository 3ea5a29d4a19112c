"""Twin of a robot: the simulation behind the robot's network protocol.

`python -m aslip.twin` starts a twin that waits for a client.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.twin.drive import CommandedPD
    from aslip.twin.engine import ENGINES, drake_engine, mujoco_engine
    from aslip.twin.lockstep import serve_lockstep
    from aslip.twin.real_time import Load, RealTimeServer
    from aslip.twin.robot import TwinRobot

__all__ = [
    "ENGINES",
    "CommandedPD",
    "Load",
    "RealTimeServer",
    "TwinRobot",
    "drake_engine",
    "mujoco_engine",
    "serve_lockstep",
]

__getattr__, __dir__ = attach(
    __name__,
    {
        "drive": ["CommandedPD"],
        "engine": ["ENGINES", "drake_engine", "mujoco_engine"],
        "lockstep": ["serve_lockstep"],
        "real_time": ["Load", "RealTimeServer"],
        "robot": ["TwinRobot"],
    },
)
