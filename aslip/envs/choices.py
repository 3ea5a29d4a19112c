"""Names of choices; imports nothing heavy, for command lines."""

from __future__ import annotations

from typing import Literal

Backend = Literal["batch", "dm_control"]
"""Simulators."""

RewardSource = Literal["truth", "estimate"]
"""Sources of the state that rewards read."""
