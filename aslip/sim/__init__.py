"""The robot's low level at 2 kHz: sensors, motor drive, delay, and N simulations side by side."""

from aslip.sim.drive import Drive, motor_torque
from aslip.sim.dynamics import DYNAMICS, Dynamics
from aslip.sim.pool import SimulationPool
from aslip.sim.sensors import Sensors
from aslip.sim.simulations import Simulations
from aslip.sim.truth import Snapshot, true_state

__all__ = [
    "DYNAMICS",
    "Drive",
    "Dynamics",
    "Sensors",
    "SimulationPool",
    "Simulations",
    "Snapshot",
    "motor_torque",
    "true_state",
]
