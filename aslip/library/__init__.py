"""Motions at all commands with the joint angles of the robot, in one table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
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

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "build": ["build_library"],
        "library": ["GaitLibrary", "Reference"],
        "pendulum": ["PendulumWalk", "pendulum_library", "single_reference_library"],
    },
)
