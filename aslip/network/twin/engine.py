"""Simulations that a twin can run on: MuJoCo by default, Drake as a second engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, Union

from aslip.robot import Robot
from aslip.sim import MakeDrive, Simulations
from aslip.sim.course import Course
from aslip.sim.drake import Contact
from aslip.sim.stones import course_model

if TYPE_CHECKING:
    from aslip.sim.drake import DrakeSimulation


Engine = Union[Simulations, "DrakeSimulation"]
"""Simulation of one robot with its low level."""

MakeEngine = Callable[[Robot, MakeDrive], Engine]
"""Function of robot and drive that makes a simulation."""


def mujoco_engine(robot: Robot, drive: MakeDrive, course: Course | None = None) -> Engine:
    """Make the simulation of a robot in MuJoCo, on the flat floor or on a course."""
    model = None if course is None else course_model(course, visual=False)
    return Simulations(1, model=model, num_threads=1, robot=robot, drive=drive)


def drake_engine(robot: Robot, drive: MakeDrive, contact: Contact | None = None) -> Engine:
    """Make the simulation of a robot in Drake, with Drake's own contact by default.

    Raises:
        MissingExtraError: Drake is not installed.
    """
    from aslip.sim.drake import DrakeSimulation

    return DrakeSimulation(robot=robot, drive=drive, contact=contact)


ENGINES: Final[Mapping[str, MakeEngine]] = {"mujoco": mujoco_engine, "drake": drake_engine}
"""Functions that make a simulation, by the name of its physics engine."""
