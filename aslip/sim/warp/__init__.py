"""N simulations of a robot and its low level on one device, on MuJoCo Warp.

They need the extra aslip[gpu].
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
