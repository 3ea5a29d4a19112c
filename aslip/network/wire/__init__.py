"""Cassie's network protocol without a simulator: packets, datagrams, conversions, UDP sockets."""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
