"""Sliders of the command; for policies that walk in all directions also keys and a gamepad.

Robots that stand on a wish have a button for it, which a key and the gamepad press, too.

Browsers read keys and gamepads themselves: a script on the page writes the command that they ask
for into a text field, which the simulation reads as it reads sliders.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import viser

from aslip.library import Command
from aslip.show.live.server import Check, number_within

_SPEED_STEP = 0.05
_LABELS = ("forward [m/s]", "sideways [m/s]", "turn [rad/s]")
_FIELD = "steer"
_STAND, _WALK = "Stand", "Walk"

# `onerror` runs the script, because browsers ignore <script> in HTML that is set later. Keys change
# the command by steps, sticks set it; both listen before viser, whose camera moves with WASD.
_SCRIPT = """
(() => {
  if (window.aslipSteering) return;
  window.aslipSteering = true;
  const labels = LABELS, steps = [0.1, 0.05, 0.1];
  const keys = {KeyW: [0, 1], KeyS: [0, -1], ArrowUp: [0, 1], ArrowDown: [0, -1],
    KeyA: [1, 1], KeyD: [1, -1], ArrowLeft: [1, 1], ArrowRight: [1, -1],
    KeyQ: [2, 1], KeyE: [2, -1]};
  const row = text => [...document.querySelectorAll('label')]
    .find(label => label.textContent === text)?.parentElement?.parentElement?.parentElement;
  const read = name => labels.map(text =>
    Number(row(text)?.querySelector('[role=slider]')?.getAttribute(name) ?? 0));
  let wish = null, until = 0;
  const write = values => {
    const input = row(FIELD)?.querySelector('input');
    if (!input) return;
    const low = read('aria-valuemin'), high = read('aria-valuemax');
    wish = values.map((value, i) => Math.min(Math.max(value, low[i]), high[i]));
    until = performance.now() + 1000;  // sliders follow later on a slow machine
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
    set.call(input, wish.map(value => value.toFixed(2)).join(', '));
    input.dispatchEvent(new Event('input', {bubbles: true}));
  };
  const stand = () => [...document.querySelectorAll('button')]
    .find(button => STANDS.includes(button.textContent.trim()));
  window.addEventListener('keydown', event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest?.('input, textarea, [role=slider], [role=combobox]')) return;
    if (event.code === 'KeyC' && stand()) {
      event.preventDefault();
      event.stopImmediatePropagation();
      if (!event.repeat) stand().click();
      return;
    }
    const key = keys[event.code];
    if (!key && event.code !== 'KeyX') return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const values = !key ? [0, 0, 0]
      : [...(performance.now() < until ? wish : read('aria-valuenow'))];
    if (key) values[key[0]] += key[1] * steps[key[0]];
    write(values);
  }, true);
  let moved = false, held = false;
  const poll = () => {
    const pad = [...(navigator.getGamepads?.() ?? [])].find(pad => pad && pad.connected);
    if (!pad) return;
    const pressed = Boolean(pad.buttons?.[0]?.pressed);
    if (pressed && !held) stand()?.click();
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
        stands: True for robots that stand on a wish.
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
        """Text field of the command that keys and gamepad ask for; None with forward speed only."""
        if len(limits) > 1:
            self.field = gui.add_text(_FIELD, _text(command), hint="forward, sideways, turn")
            help_text = _HELP.replace("STANDING", _STAND_HELP if stands else "")
            gui.add_html(help_text + _image())
        self.stand = gui.add_button(_STAND, icon=viser.Icon.HAND_STOP) if stands else None
        """Button of the wish to stand; None for robots that cannot."""
        self._known = "" if self.field is None else self.field.value

    def checks(self) -> dict[str, Check]:
        """Checks of the values that visitors send, by the uuid of the control."""
        found: dict[str, Check] = {
            slider._impl.uuid: number_within(slider.min, slider.max) for slider in self.sliders
        }
        if self.field is not None:
            found[self.field._impl.uuid] = self._checked_text
        return found

    def show_standing(self, stand: bool) -> None:
        """Label the button with the wish that it leads to."""
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
        values = [float(slider.value) for slider in self.sliders]
        if (shown := _text(values)) != self._known:
            self.field.value = self._known = shown
        return tuple(values)

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
    script = script.replace("STANDS", f"['{_STAND}', '{_WALK}']")
    return f"<img src='data:,' style='display:none' onerror=\"{html.escape(script)}\">"
