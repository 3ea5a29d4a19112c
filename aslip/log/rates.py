"""Rates of logging; imports nothing heavy, for command lines."""

from __future__ import annotations

from typing import Literal

JointRate = Literal["policy", "physics"]
"""Rates at which joints are logged."""
