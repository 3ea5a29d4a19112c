"""State estimation: sensor packets in, estimated state out.

Robots and simulations run `StateEstimator`. It screens the packets (`packets`), computes foot
positions and forces (`legs`), and fuses them with the IMU (`filter`).
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
