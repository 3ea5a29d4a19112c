"""State estimation: sensor packets in, estimated state out.

Robots and simulations run `StateEstimator`. It screens the packets (`packets`), computes foot
positions and forces (`legs`), and fuses them with the IMU (`filter`).
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
