"""Choices of an environment; importing them loads no library."""

from typing import Literal

Backend = Literal["batch", "dm_control", "warp"]
"""Simulators."""

RewardSource = Literal["truth", "estimate"]
"""Sources of the state that rewards read."""
