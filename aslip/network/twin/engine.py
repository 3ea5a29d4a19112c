"""Simulations that a twin can run on: MuJoCo by default, Drake as a second engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Protocol

import numpy as np

from aslip.robot import Robot
from aslip.sim import MakeDrive, Sensors, Simulations, Snapshot
from aslip.sim.drake import Contact


class Engine(Protocol):
    """Simulation of one robot with its low level; see `aslip.sim.Simulations` for all members."""

    sensors: Sensors
    divergences: int

    def stand(self) -> None:
        """Set the robot on its feet, at rest."""
        ...

    def advance(self, motor_target: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Run one period; return (1,) bool, True if the simulation diverged and was reset."""
        ...

    @property
    def motor_torque(self) -> np.ndarray:
        """(1, m) torques of the motors at the joints in the last substep [N m]."""
        ...

    def snapshot(self) -> Snapshot:
        """Arrays of the true state."""
        ...

    def states(self) -> np.ndarray:
        """(1, k) copy of the complete state."""
        ...


MakeEngine = Callable[[Robot, MakeDrive], Engine]
"""Function of robot and drive that makes a simulation."""


def mujoco_engine(robot: Robot, drive: MakeDrive) -> Engine:
    """Make the simulation of a robot in MuJoCo."""
    return Simulations(1, num_threads=1, robot=robot, drive=drive)


def drake_engine(robot: Robot, drive: MakeDrive, contact: Contact | None = None) -> Engine:
    """Make the simulation of a robot in Drake, with Drake's own contact by default.

    Raises:
        MissingExtraError: Drake is not installed.
    """
    from aslip.sim.drake import DrakeSimulation

    return DrakeSimulation(robot=robot, drive=drive, contact=contact)


ENGINES: Final[Mapping[str, MakeEngine]] = {"mujoco": mujoco_engine, "drake": drake_engine}
"""Functions that make a simulation, by the name of its physics engine."""
