"""Sliders and button with which visitors push the robot."""

from __future__ import annotations

import numpy as np
import viser

from aslip.robot import CASSIE
from aslip.show.live.server import Check, note, number_within, switch

PUSH_DURATION = 4 * CASSIE.policy_period
"""Duration of a push [s], in whole policy steps."""

_LIMIT, _STEP, _START = 300, 10, 120
_TURN_STEP = 15
_DIRECTION = "Of the force, as the robot sees it: 0 to its front, 90 to its left, -90 to its right."


class PushControls:
    """Direction and size of a push, and the button that starts it.

    Args:
        gui: interface of the server.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Push"):
            self.direction = gui.add_slider("direction [°]", -180, 180, _TURN_STEP, 90)
            gui.add_html(note(_DIRECTION))
            self.size = gui.add_slider("force [N]", 0, _LIMIT, _STEP, _START)
            self.button = gui.add_button(f"Push for {PUSH_DURATION:g} s")

    def checks(self) -> dict[str, Check]:
        """Check of each control's value, by uuid."""
        sliders = {
            slider._impl.uuid: number_within(slider.min, slider.max)
            for slider in (self.direction, self.size)
        }
        return {**sliders, self.button._impl.uuid: switch}

    def force(self) -> np.ndarray:
        """(3,) force of a push [N, heading frame: x ahead, y to the left]."""
        angle = np.deg2rad(self.direction.value)
        return self.size.value * np.array([np.cos(angle), np.sin(angle), 0.0])
