"""The robot's state from its sensors: packets in, estimate out; no simulator, no network.

`StateEstimator` is what a robot or a simulation runs. Inside, packets are checked (`packets`), legs
turned into foot positions and forces (`legs`), and both joined with the IMU (`filter`).
"""

from aslip.estimation.estimator import StateEstimator
from aslip.estimation.filter import Belief, FilterNoise
from aslip.estimation.legs import LegKinematics
from aslip.estimation.packets import FAULTS
from aslip.estimation.state import Estimate, Tracking, tracking_size

__all__ = [
    "FAULTS",
    "Belief",
    "Estimate",
    "FilterNoise",
    "LegKinematics",
    "StateEstimator",
    "Tracking",
    "tracking_size",
]
