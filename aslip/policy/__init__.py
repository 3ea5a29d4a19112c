"""Policies: networks, normaliser, symmetry and files."""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
