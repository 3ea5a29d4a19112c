"""Defaults of a library's grid; imports nothing heavy, for command lines."""

from __future__ import annotations

PAPER_SPEEDS = tuple(round(0.1 * i, 1) for i in range(21))
"""0 to 2 m/s in steps of 0.1 m/s (Sec. III-A)."""

PHASE_SAMPLES = 128
"""Samples of a stride: one every 6 ms, five a policy step."""
