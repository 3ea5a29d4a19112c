"""The robot's state from its sensors: packets in, estimate out; no simulator, no network.

`StateEstimator` is what a robot or a simulation runs. Inside, packets are checked (`packets`), legs
turned into foot positions and forces (`legs`), and both joined with the IMU (`filter`).
"""

from aslip.estimation.estimator import (
    TRACKING_SIZE,
    Estimate,
    StateEstimator,
    Tracking,
)
from aslip.estimation.filter import Belief, FilterNoise
from aslip.estimation.legs import LegKinematics
from aslip.estimation.packets import FAULTS, PACKET_SIZE

__all__ = [
    "FAULTS",
    "PACKET_SIZE",
    "TRACKING_SIZE",
    "Belief",
    "Estimate",
    "FilterNoise",
    "LegKinematics",
    "StateEstimator",
    "Tracking",
]
