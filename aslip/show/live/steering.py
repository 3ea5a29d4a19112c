"""Sliders of the command; for policies that walk in all directions also keys and a gamepad.

Robots that can stand have a button for it, which a key and the gamepad also press.

Keys are those of viser's commands: the browser sends every press, and the simulation takes them
from a queue. Gamepads are read by a script on the page, which writes the command that they ask for
into a text field; the simulation reads that as it reads sliders.
"""

from __future__ import annotations

import html
import math
import queue
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import viser

from aslip.library import Command
from aslip.show.live.server import Check, number_within

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

# `onerror` runs the script, because browsers ignore <script> in HTML that is set later. Events of
# keys go from the page's controls to viser's commands, which listen at the root element, then to
# viser's camera, which moves with WASD.
_SCRIPT = """
(() => {
  if (window.aslipSteering) return;
  window.aslipSteering = true;
  const labels = LABELS, root = document.documentElement;
  const row = text => [...document.querySelectorAll('label')]
    .find(label => label.textContent === text)?.parentElement?.parentElement?.parentElement;
  const read = name => labels.map(text =>
    Number(row(text)?.querySelector('[role=slider]')?.getAttribute(name) ?? 0));
  const write = values => {
    const input = row(FIELD)?.querySelector('input');
    if (!input) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
    set.call(input, values.map(value => value.toFixed(2)).join(', '));
    input.dispatchEvent(new Event('input', {bubbles: true}));
  };
  document.body.addEventListener('keydown', event => {
    const slides = event.code?.startsWith('Arrow') && event.target.closest?.('[role=slider]');
    if (slides || (event.code === 'KeyC' && event.repeat)) event.stopPropagation();
  });
  root.addEventListener('keydown', event => {
    const held = event.ctrlKey || event.metaKey || event.altKey || event.shiftKey;
    if (!held && /^(Key[WSADQEXC]|Arrow.*)$/.test(event.code)) event.stopPropagation();
  });
  let moved = false, held = false;
  const poll = () => {
    const pad = [...(navigator.getGamepads?.() ?? [])].find(pad => pad && pad.connected);
    if (!pad) return;
    const pressed = Boolean(pad.buttons?.[0]?.pressed);
    if (pressed && !held)
      root.dispatchEvent(new KeyboardEvent('keydown', {code: 'KeyC', key: 'c'}));
    held = pressed;
    const stick = [1, 0, 2].map(i => {
      const value = -(pad.axes[i] ?? 0), size = Math.abs(value);
      return size < 0.12 ? 0 : Math.sign(value) * (size - 0.12) / 0.88;
    });
    const any = stick.some(value => value !== 0);
    if (!any && !moved) return;
    moved = any;
    const low = read('aria-valuemin'), high = read('aria-valuemax');
    write(stick.map((share, i) => share > 0 ? share * high[i] : -share * low[i]));
  };
  // not with frames, which are few where the scene is drawn in software
  setInterval(poll, 60);
})();
"""

_HELP = (
    "<div style='padding:0 0.5em 0.5em;font-size:0.8em;color:#6b7280'>Keys: W S or \u2191 \u2193"
    " forward, A D or \u2190 \u2192 sideways, Q E turn, X stop. Gamepad: left stick walks, right"
    " stick turns.STANDING</div>"
)
_STAND_HELP = " C or the gamepad's first button: stand, and walk again."


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
        labels = ("command [m/s]",) if len(limits) == 1 else _LABELS[: len(limits)]
        self.sliders = [
            gui.add_slider(label, *ends, _SPEED_STEP, value)
            for label, ends, value in zip(labels, limits, command, strict=True)
        ]
        """A slider for each number of a command."""
        self.field: viser.GuiInputHandle[str] | None = None
        """Text field of the command that a gamepad asks for; None with forward speed only."""
        self._presses: queue.SimpleQueue[tuple[int, float] | None] = queue.SimpleQueue()
        self.keys: dict[str, Callable[[], object]] = {}
        """Function to call at each press of a key, by the uuid of its command."""
        if len(limits) > 1:
            self._add_keys(gui)
            self.field = gui.add_text(_FIELD, _text(command), hint="forward, sideways, turn")
            help_text = _HELP.replace("STANDING", _STAND_HELP if stands else "")
            gui.add_html(help_text + _image())
        self.stand = gui.add_button(_STAND, icon=viser.Icon.HAND_STOP) if stands else None
        """Button of the stand command; None for robots that cannot."""
        self._known = "" if self.field is None else self.field.value

    def _add_keys(self, gui: viser.GuiApi) -> None:
        """Add commands whose keys change the command by steps, or stop."""
        for key, (axis, sign) in _KEYS.items():
            change = sign * _CHANGES[axis]
            self.add_key(
                gui, f"{_LABELS[axis]} {change:+g}", key, partial(self._presses.put, (axis, change))
            )
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
        found: dict[str, Check] = {
            slider._impl.uuid: number_within(slider.min, slider.max) for slider in self.sliders
        }
        if self.field is not None:
            found[self.field._impl.uuid] = self._checked_text
        return found

    def show_standing(self, stand: bool) -> None:
        """Label the button with the command that it gives."""
        if self.stand is not None:
            self.stand.label = _WALK if stand else _STAND
            self.stand.icon = viser.Icon.WALK if stand else viser.Icon.HAND_STOP

    def command(self) -> Command:
        """Present command; a new text moves the sliders, moved sliders change the text."""
        if self.field is None:
            return self.sliders[0].value
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
        return tuple(values)

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


def _image() -> str:
    """Invisible image that cannot be loaded, so that its error handler runs the script."""
    labels = "[" + ", ".join(f"'{label}'" for label in _LABELS) + "]"
    script = _SCRIPT.replace("LABELS", labels).replace("FIELD", f"'{_FIELD}'")
    return f"<img src='data:,' style='display:none' onerror=\"{html.escape(script)}\">"
