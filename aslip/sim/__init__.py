"""Low level at 2 kHz: sensors, motor drive and delay; batches of N simulations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.sim.drive import PD, Drive, MakeDrive, Torque
    from aslip.sim.dynamics import Dynamics
    from aslip.sim.parameters import DYNAMICS
    from aslip.sim.pool import SimulationPool
    from aslip.sim.sensors import Sensors
    from aslip.sim.simulations import Simulations
    from aslip.sim.truth import Snapshot, true_state

__all__ = [
    "DYNAMICS",
    "PD",
    "Drive",
    "Dynamics",
    "MakeDrive",
    "Sensors",
    "SimulationPool",
    "Simulations",
    "Snapshot",
    "Torque",
    "true_state",
]

__getattr__, __dir__ = attach(
    __name__,
    {
        "drive": ["PD", "Drive", "MakeDrive", "Torque"],
        "dynamics": ["Dynamics"],
        "parameters": ["DYNAMICS"],
        "pool": ["SimulationPool"],
        "sensors": ["Sensors"],
        "simulations": ["Simulations"],
        "truth": ["Snapshot", "true_state"],
    },
)
