"""Robots: a frozen `Robot` with names, low level, timing and indices; `CASSIE` is one.

Only `aslip.robot.model` and `aslip.robot.compile` need MuJoCo; import them by their own names.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
