"""Sliders, keys, touch buttons and a gamepad for the command.

Robots that can stand have a button for it, which a key and the gamepad also press.

Keys are those of viser's commands: the browser sends every press, and the simulation takes them
from a queue. Touch buttons press keys. Gamepads are read by a script on the page, `head.html`,
which writes the command that they ask for into a hidden text field; the simulation reads that as it
reads sliders.
"""

from __future__ import annotations

import math
import queue
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import viser

from aslip.library import Command
from aslip.show.live.server import Check, note, number_within

_SPEED_STEP = 0.05
_LABELS = ("forward [m/s]", "sideways [m/s]", "turn [rad/s]")
_FIELD = "steer"
_STAND, _WALK = "Stand", "Walk"

_CHANGES = (0.1, 0.05, 0.1)
# key -> number of the command, and sign of its change; the last four are arrows
_KEYS = {
    **{"W": (0, 1), "S": (0, -1), "A": (1, 1), "D": (1, -1), "Q": (2, 1), "E": (2, -1)},
    **{"arrowup": (0, 1), "arrowdown": (0, -1), "arrowleft": (1, 1), "arrowright": (1, -1)},
}

# keys of each number of the command
_HELP = ("W S or \u2191 \u2193 forward", "A D or \u2190 \u2192 sideways", "Q E turn")
# key, sign and name of the touch buttons, in rows of three; numbers of the command that they change
_BUTTONS = (
    ("Q", "\u21ba", "turn left"), ("W", "\u2191", "forward"), ("E", "\u21bb", "turn right"),
    ("A", "\u2190", "left"), ("X", "stop", "stop"), ("D", "\u2192", "right"),
    ("C", "stand", "stand, or walk"), ("S", "\u2193", "backward"),
)  # fmt: skip


def steering_keys(numbers: int, stands: bool) -> str:
    """Keys that steer, in words.

    Args:
        numbers: numbers of a command.
        stands: True for robots that can stand.
    """
    return ", ".join([*_HELP[:numbers], "X stop", *["C stand, or walk"] * stands])


def steering_head(numbers: int, stands: bool) -> dict[str, object]:
    """Values that the script in `head.html` needs to steer; see `steering_keys`."""
    own = {"X", *"C" * stands, *(key for key, (axis, _) in _KEYS.items() if axis < numbers)}
    buttons = [button if button[0] in own else ("", "", "") for button in _BUTTONS]
    return {"LABELS": _LABELS[:numbers], "FIELD": _FIELD, "BUTTONS": buttons}


class Steering:
    """Controls of the command on a page.

    Args:
        gui: interface of the server, within the panel to fill.
        limits: lowest and highest value of each number of a command.
        command: first command.
        stands: True for robots that can stand.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        limits: Sequence[tuple[float, float]],
        command: Sequence[float],
        stands: bool = False,
    ) -> None:
        self.sliders = [
            gui.add_slider(label, *ends, _SPEED_STEP, value)
            for label, ends, value in zip(_LABELS, limits, command, strict=False)
        ]
        """A slider for each number of a command."""
        self.field = gui.add_text(_FIELD, _text(command))
        """Hidden text field of the command that a gamepad asks for."""
        self._presses: queue.SimpleQueue[tuple[int, float] | None] = queue.SimpleQueue()
        self.keys: dict[str, Callable[[], object]] = {}
        """Function to call at each press of a key, by the uuid of its command."""
        self._add_keys(gui)
        pad = "left stick walks" + ", right stick turns" * (len(limits) > 2)
        pad += ", first button stands" * stands
        gui.add_html(note(f"Keys: {steering_keys(len(limits), stands)}. Gamepad: {pad}."))
        self.stand = gui.add_button(_STAND, icon=viser.Icon.HAND_STOP) if stands else None
        """Button of the stand command; None for robots that cannot."""
        self._known = self.field.value

    def _add_keys(self, gui: viser.GuiApi) -> None:
        """Add commands whose keys change the command by steps, or stop."""
        for key, (axis, sign) in _KEYS.items():
            change = sign * _CHANGES[axis]
            if axis < len(self.sliders):
                press = partial(self._presses.put, (axis, change))
                self.add_key(gui, f"{_LABELS[axis]} {change:+g}", key, press)
        self.add_key(gui, "stop", "X", partial(self._presses.put, None))

    def add_key(self, gui: viser.GuiApi, label: str, key: Any, press: Callable[[], object]) -> None:
        """Add a command of viser's palette with a key.

        Args:
            gui: interface of the server.
            label: label in the palette.
            key: the key, in viser's words.
            press: function to call at each press, on the server's thread.
        """
        self.keys[gui.add_command(label, hotkey=key)._impl.uuid] = press

    def checks(self) -> dict[str, Check]:
        """Checks of the values that visitors send, by the uuid of the control."""
        return {
            **{s._impl.uuid: number_within(s.min, s.max) for s in self.sliders},
            self.field._impl.uuid: self._checked_text,
        }

    def show_standing(self, stand: bool) -> None:
        """Label the button with the command that it gives."""
        if self.stand is not None:
            self.stand.label = _WALK if stand else _STAND
            self.stand.icon = viser.Icon.WALK if stand else viser.Icon.HAND_STOP

    def command(self) -> Command:
        """Present command; a new text moves the sliders, moved sliders change the text."""
        # read once: a visitor may change it at any time
        text = self.field.value
        if text != self._known:
            self._known = text
            for slider, value in zip(self.sliders, _numbers(text), strict=True):
                slider.value = value
        for _ in range(self._presses.qsize()):
            self._press(self._presses.get_nowait())
        values = [float(slider.value) for slider in self.sliders]
        if (shown := _text(values)) != self._known:
            self.field.value = self._known = shown
        return tuple(values) if len(values) > 1 else values[0]

    def _press(self, change: tuple[int, float] | None) -> None:
        """Move the slider of a pressed key within its range; all to zero for None."""
        for i, slider in enumerate(self.sliders):
            if change is None or change[0] == i:
                value = 0.0 if change is None else round(slider.value + change[1], 6)
                slider.value = min(max(value, slider.min), slider.max)

    def _checked_text(self, value: object) -> str:
        """Command of a visitor's text, within the sliders' ranges.

        Raises:
            ValueError: the text is no command.
        """
        if not isinstance(value, str) or len(value) > 100:
            raise ValueError(f"no command: {value!r:.40}")
        given = _numbers(value)
        if len(given) != len(self.sliders) or not all(map(math.isfinite, given)):
            raise ValueError(f"no command: {value!r:.40}")
        pairs = zip(self.sliders, given, strict=True)
        return _text([min(max(number, slider.min), slider.max) for slider, number in pairs])


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def _text(command: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in command)
