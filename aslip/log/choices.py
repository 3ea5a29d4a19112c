"""Choices of a log; importing them loads no library."""

from typing import Literal

JointRate = Literal["policy", "physics"]
"""Rate at which joints are logged: every policy step, or every substep."""
