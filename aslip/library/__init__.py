"""Walking gaits at all speeds with the robot's joint angles, in one file."""

from aslip.library.build import build_library
from aslip.library.library import GaitLibrary, Reference
from aslip.library.pendulum import PendulumWalk, pendulum_library, single_reference_library

__all__ = [
    "GaitLibrary",
    "PendulumWalk",
    "Reference",
    "build_library",
    "pendulum_library",
    "single_reference_library",
]
