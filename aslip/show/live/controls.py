"""Sliders, buttons and choices of the page.

The simulation reads sliders and choices once per turn, and takes clicks from a queue, which the
server's threads fill.
"""

from __future__ import annotations

import queue
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import viser

from aslip.library import Command
from aslip.robot import CASSIE
from aslip.show.live.pushes import PushControls
from aslip.show.live.server import Check, guard, note, one_of, switch
from aslip.show.live.steering import Steering
from aslip.show.live.stones import StonesView
from aslip.show.model_place import ROM_PLACES, RomPlace

Click = Literal["pause", "step", "reset", "push", "stand", "add stone", "restore stones"]

_LEGEND = (
    "Blue is the left leg, red the right, pale in swing. Discs are the next planned footholds."
)


@dataclass(frozen=True)
class Settings:
    """Values of sliders and choices."""

    command: Command
    """Forward speed [m/s]; in all directions forward, sideways speed [m/s] and yaw rate [rad/s]."""
    policy: str
    """Name of the acting policy."""
    rom: RomPlace
    """Place of the reduced-order model."""
    auto_reset: bool
    """Reset the robot after a fall."""


class Controls:
    """Sliders, buttons and choices that all visitors of the page share.

    Only valid values are accepted; numbers out of range are clamped.

    Args:
        server: server of the page.
        limits: lowest and highest value of each number of a command.
        command: first command.
        policies: names to choose from; the first one is chosen.
        stands: True for robots that can stand.
        stones: (s, 6) stones to move, see `StonesView`; None for robots without.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        *,
        limits: Sequence[tuple[float, float]],
        command: Sequence[float],
        policies: Sequence[str],
        stands: bool = False,
        stones: np.ndarray | None = None,
    ) -> None:
        self._clicks: queue.SimpleQueue[Click] = queue.SimpleQueue()
        gui = server.gui
        self.steering = Steering(gui, limits, command, stands)
        self.command = self.steering.sliders[0]
        self.policy = gui.add_dropdown("policy", tuple(policies))
        with gui.add_folder("Time"):
            self.pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
            self.step = gui.add_button(
                f"Step ({1000 * CASSIE.policy_period:.0f} ms)",
                icon=viser.Icon.PLAYER_TRACK_NEXT,
                disabled=True,
            )
            self.reset = gui.add_button("Reset", icon=viser.Icon.REFRESH)
            self.auto_reset = gui.add_checkbox("reset after a fall", True)
        self.pushes = PushControls(gui)
        self.stones = None if stones is None else StonesView(server.scene, gui, stones)
        with gui.add_folder("View"):
            self.rom = gui.add_dropdown("spring-mass model", ROM_PLACES)
            gui.add_html(note(_LEGEND))
        buttons: dict[Click, viser.GuiButtonHandle] = {
            "pause": self.pause,
            "step": self.step,
            "reset": self.reset,
            "push": self.pushes.button,
        }
        if self.steering.stand is not None:
            buttons["stand"] = self.steering.stand
            self.steering.add_key(gui, "stand, or walk", "C", lambda: self._clicks.put("stand"))
        if self.stones is not None:
            buttons |= {"add stone": self.stones.add, "restore stones": self.stones.restore}
        for click, button in buttons.items():
            button.on_click(lambda _, click=click: self._clicks.put(click))
        self._guard(server, buttons.values())

    def _guard(self, server: viser.ViserServer, buttons: Iterable[viser.GuiButtonHandle]) -> None:
        """Check the values that visitors send."""
        checks: dict[str, Check] = {}
        checks |= {control._impl.uuid: switch for control in (*buttons, self.auto_reset)}
        checks |= self.steering.checks()
        checks |= self.pushes.checks()
        for choice in (self.policy, self.rom):
            checks[choice._impl.uuid] = one_of(choice.options)
        touch = None if self.stones is None else self.stones.take
        guard(server, checks, self.steering.keys, touch)

    def settings(self) -> Settings:
        """Present values."""
        return Settings(
            command=self.steering.command(),
            policy=self.policy.value,
            rom=self.rom.value,
            auto_reset=self.auto_reset.value,
        )

    def clicks(self) -> Iterator[Click]:
        """Clicks since the last call, in order."""
        while True:
            try:
                yield self._clicks.get_nowait()
            except queue.Empty:
                return

    def show_paused(self, paused: bool) -> None:
        """Label the pause button with its next action; enable single steps only while paused."""
        self.pause.label = "Resume" if paused else "Pause"
        self.step.disabled = not paused
        self.pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE
