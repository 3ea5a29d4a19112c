"""Colours of robot, model and legs in scenes and plots.

Blue is the left leg and red the right leg; no other curve is blue or red.
"""

from __future__ import annotations

LEFT, RIGHT = "#1f78b5", "#d6302e"
"""Left and right leg, and their forces."""
MODEL = "#333d52"
"""Body and curves of the reduced-order model."""
ROBOT = "#e08a1e"
"""Curves of the simulated robot."""
COMMAND = "#7f7f7f"
"""Commanded speed."""
SERIES = (ROBOT, "#1b8a7a", "#8e5bb5", MODEL, "#a3a3a3")
"""Curves that are compared with each other, such as policies: at most five."""


def rgba(color: str) -> tuple[float, float, float, float]:
    """Red, green, blue and an opacity of 1, from 0 to 1, of "#rrggbb"."""
    red, green, blue = (part / 255 for part in bytes.fromhex(color.removeprefix("#")))
    return red, green, blue, 1.0
