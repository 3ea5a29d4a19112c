"""Simulation in Drake, a physics engine with dynamics, contact model and solver of its own.

The simulation needs the extra aslip[drake].
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
