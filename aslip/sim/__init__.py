"""Low level at 2 kHz: sensors, motor drive and delay; batches of N simulations."""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
