"""Metrics of a walk: pure functions of arrays, each with its definition and source.

Arrays have time first. A "stance" is a row of two sample indices, first and one past the last.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
