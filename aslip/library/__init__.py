"""Walking gaits at all speeds with the robot's joint angles, in one file."""

from aslip.library.build import build_library
from aslip.library.library import GaitLibrary, Reference

__all__ = ["GaitLibrary", "Reference", "build_library"]
