"""Gait libraries: motions over a grid of commands, with joint angles of the robot.

    walks = optimize_gaits((0.0, 0.5, 1.0), parameters=SlipParameters(mass=33.3))
    library = GaitLibrary.from_motions(walks)      # inverse kinematics
    library.save("gaits.npz")
    library = GaitLibrary.load("gaits.npz")        # without a path, the shipped one
    library.lookup(phase, command).motor_position

A library is made of motions of any reduced-order model, see `aslip.rom.Motion`. Looking motions up
imports none of CasADi, Pinocchio and MuJoCo.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.library.directions import (
        DirectionGrid,
        GaitFolder,
        convex_gaits,
        solve_directions,
    )
    from aslip.library.library import GaitLibrary
    from aslip.library.pendulum import pendulum_library, single_reference_library
    from aslip.library.reference import Reference
    from aslip.library.schedule import Command, Schedule, numbers
    from aslip.library.table import PAPER_SPEEDS, GaitTable
    from aslip.library.tabulate import tabulate, tabulate_transitions
    from aslip.library.transitions import TransitionTable, WalkMode

__all__ = [
    "PAPER_SPEEDS",
    "Command",
    "DirectionGrid",
    "GaitFolder",
    "GaitLibrary",
    "GaitTable",
    "Reference",
    "Schedule",
    "TransitionTable",
    "WalkMode",
    "convex_gaits",
    "numbers",
    "pendulum_library",
    "single_reference_library",
    "solve_directions",
    "tabulate",
    "tabulate_transitions",
]

__getattr__, __dir__ = attach(
    __name__,
    {
        "directions": ["DirectionGrid", "GaitFolder", "convex_gaits", "solve_directions"],
        "library": ["GaitLibrary"],
        "pendulum": ["pendulum_library", "single_reference_library"],
        "reference": ["Reference"],
        "schedule": ["Command", "Schedule", "numbers"],
        "table": ["PAPER_SPEEDS", "GaitTable"],
        "tabulate": ["tabulate", "tabulate_transitions"],
        "transitions": ["TransitionTable", "WalkMode"],
    },
)
