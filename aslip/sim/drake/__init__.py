"""Simulation in Drake, a physics engine with dynamics, contact model and solver of its own.

The simulation needs the extra aslip[drake].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.sim.drake.contact import Contact
    from aslip.sim.drake.plant import Mechanism
    from aslip.sim.drake.simulation import DrakeSimulation

__all__ = ["Contact", "DrakeSimulation", "Mechanism"]

__getattr__, __dir__ = attach(
    __name__,
    {
        "contact": ["Contact"],
        "plant": ["Mechanism"],
        "simulation": ["DrakeSimulation"],
    },
)
