"""Live page and its loop; one thread owns the robot."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import AslipError, ConfigurationError
from aslip.library import Command, WalkMode, numbers
from aslip.policy import check_policy_fits, load_policy
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.live.controls import Click, Controls
from aslip.show.live.pushes import PUSH_DURATION
from aslip.show.live.readouts import ROBOT_LABEL, Readouts
from aslip.show.live.scene import SceneView
from aslip.show.live.server import page_url, start_server
from aslip.show.live.steering import steering_head, steering_keys
from aslip.show.pacing import Pacer
from aslip.walking import Walker

# turns of the loop from a fall to the reset (1 s)
_TURNS_ON_THE_GROUND = round(1.0 / CASSIE.policy_period)
# turns of the loop between two updates of the numbers (5.6 Hz)
_TURNS_PER_READOUT = 6

_PANEL_WIDTH = 340
_TITLE = f"{ROBOT_LABEL}, live"


class LivePage:
    """Page to watch and steer one robot in real time.

    The server starts in the constructor. The simulation runs in `serve`; meanwhile its thread alone
    may use the walker.

    Args:
        walker: robot to watch; its present command is the first value of the slider.
        policies: name -> policy, or its name or path; the first one acts at the start. By default
            the policy of the walker.
        host: name or address of this machine to listen on. With "0.0.0.0" other machines can see
            the page and steer, without authentication.
        port: port to listen on; 0 for any free one.
        on_step: function called with each result of `Walker.step`, on the thread of `serve`. An
            exception ends `serve`.

    Raises:
        ConfigurationError: the host is not this machine, the port is taken or not allowed,
            `policies` is empty, or a policy does not fit the walker's environment.
        AssetError: a policy of this name or path does not exist.
    """

    def __init__(
        self,
        walker: Walker,
        policies: Mapping[str, TensorDictModuleBase | str | Path] | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        on_step: Callable[[TensorDictBase], object] | None = None,
    ) -> None:
        if policies is None:
            policies = {"the walker's": walker.policy}
        if not policies:
            raise ConfigurationError("policies must not be empty")
        self.walker = walker
        self.paused = False
        """True while the simulation is paused."""
        self.falls = 0
        """Number of falls."""
        self._policies = {
            name: _fitting_policy(policy, walker) if isinstance(policy, str | Path) else policy
            for name, policy in policies.items()
        }
        self._on_step = on_step
        self._stopping = threading.Event()
        self._serving = threading.Lock()
        self._closed = False
        self._pacer = Pacer(CASSIE.policy_period, sleep=self._stopping.wait)
        self._turns = 0
        self._fallen_turns = 0
        self._single_steps = 0
        self._error = ""
        self._drawn: TensorDictBase | None = None
        self._last_status: tuple[list[tuple[str, str, str]], str] | None = None
        size = walker.library.command_size
        self.keys = steering_keys(size, walker.can_stand)
        """Keys that steer, in words."""
        steering = steering_head(size, walker.can_stand)
        self._server = start_server(host, port, _TITLE, steering)
        self._build()

    def _build(self) -> None:
        gui, walker = self._server.gui, self.walker
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label(_TITLE)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_WIDTH)
        self._scene = SceneView(self._server, load_model(), walker.library)
        self.controls = Controls(
            self._server,
            limits=[(float(axis[0]), float(axis[-1])) for axis in walker.library.table.axes],
            # as written: 0.8 in single precision is 0.80000001
            command=[round(value, 6) for value in numbers(walker.command)],
            policies=list(self._policies),
            stands=walker.can_stand,
            stones=walker.stones,
        )
        """Sliders, buttons and choices."""
        if self.controls.stones is not None:
            self._scene.add_stones(self.controls.stones)
        self.controls.steering.show_standing(walker.stand)
        # the walker already has its command; other settings are applied below
        self._settings = replace(self.controls.settings(), policy="", rom="through")
        panel = gui.add_panel()
        with panel.add_tab("Readouts"):
            self._readouts = Readouts(gui)
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH)
        # a plot drawn while the page opens lacks its time axis
        self._server.on_client_connect(lambda _: self._readouts.redraw())
        self._apply_settings()
        self._show()

    @property
    def url(self) -> str:
        """Address of the page on this machine."""
        return page_url(self._server)

    @property
    def factor(self) -> float:
        """Real-time factor over the last two seconds of `serve`."""
        return self._pacer.factor

    @property
    def message(self) -> str:
        """Message on the page; empty if there is none."""
        if not self.walker.fallen:
            return self._error
        then = "it starts again in a second" if self._settings.auto_reset else "click Reset"
        return f"{ROBOT_LABEL} has fallen; {then}"

    def serve(self) -> None:
        """Simulate until `stop` is called or Ctrl-C is pressed, then close the page.

        Raises:
            ConfigurationError: the page is already served, or was closed.
        """
        if not self._serving.acquire(blocking=False):
            raise ConfigurationError("this page is already served")
        try:
            if self._closed:
                raise ConfigurationError("this page was closed; create another LivePage")
            self._pacer.restart()
            while not self._stopping.is_set():
                self.turn()
                self._pacer.wait()
        except KeyboardInterrupt:
            pass
        finally:
            self._close()
            self._serving.release()

    def stop(self) -> None:
        """End `serve` after its current turn, and close the page; callable from any thread."""
        self._stopping.set()
        if self._serving.acquire(blocking=False):
            try:
                self._close()
            finally:
                self._serving.release()

    def _close(self) -> None:
        if not self._closed:
            self._closed = True
            self._server.stop()

    def turn(self) -> None:
        """Run one turn of the loop: apply clicks and settings, simulate a policy step, show it."""
        try:
            for click in self.controls.clicks():
                self._click(click)
            self._apply_settings()
            self._place_stones()
        except AslipError as error:
            self._error = str(error)
        if self.walker.fallen:
            self._wait_fallen()
        elif self._single_steps or not self.paused:
            self._single_steps = max(self._single_steps - 1, 0)
            self._step()
        self._show()

    def _click(self, click: Click) -> None:
        self._error, stones = "", self.controls.stones
        if click == "push":
            self.walker.push(self.controls.pushes.force().tolist(), PUSH_DURATION)
        elif click == "reset":
            self._reset()
        elif click == "stand":
            self.walker.stand = not self.walker.stand
            self.controls.steering.show_standing(self.walker.stand)
        elif click == "add stone" and stones is not None:
            stones.add_stone(self._scene.place)
        elif click == "restore stones" and stones is not None:
            stones.restore_all()
        elif click == "step":
            self._single_steps += self.paused
        else:
            self.paused = not self.paused
            self._single_steps = 0
            self.controls.show_paused(self.paused)

    def _place_stones(self) -> None:
        """Put stones where visitors want them."""
        stones = self.controls.stones
        if stones is None:
            return
        stones.apply(self._scene.place)
        # a reset, too, moves them back to where they were at first
        if not np.array_equal(stones.rows, cast("np.ndarray", self.walker.stones), equal_nan=True):
            self.walker.stones = stones.rows
            stones.draw()

    def _apply_settings(self) -> None:
        """Apply changed settings."""
        before, self._settings = self._settings, self.controls.settings()
        settings = self._settings
        if settings != before:
            self._error = ""
        if settings.rom != before.rom:
            self._scene.place_rom(settings.rom)
        if settings.policy != before.policy:
            self.walker.policy = self._policies[settings.policy]
        if settings.command != before.command:
            self.walker.command = self._reachable(settings.command)

    @on_cpu_in_single
    def _reachable(self, command: Command) -> Command:
        """Command moved into the region of the library, which sliders may leave at its corners."""
        if not isinstance(command, tuple):
            return command
        return tuple(self.walker.library.nearest(torch.tensor(command).double()).tolist())

    def _step(self) -> None:
        td = self.walker.step()
        self._readouts.add(td)
        if self.walker.fallen:
            self.falls += 1
            self._fallen_turns = 0
        if self._on_step is not None:
            self._on_step(td)

    def _wait_fallen(self) -> None:
        """Reset the robot after a second on the ground."""
        if self._settings.auto_reset and not self.paused:
            self._fallen_turns += 1
            if self._fallen_turns >= _TURNS_ON_THE_GROUND:
                self._reset()

    def _reset(self) -> None:
        self.walker.reset(stand=self.walker.stand)
        self._single_steps = 0

    def _show(self) -> None:
        """Send the scene, and on some turns the numbers."""
        td = self.walker.td
        if td is not self._drawn:
            self._scene.update(td)
            self._drawn = td
        if self._turns % _TURNS_PER_READOUT == 0:
            status = self._lines(), self.message
            if status != self._last_status or self._readouts.redrawing:
                self._readouts.show(*status)
                self._last_status = status
        self._turns += 1

    def _lines(self) -> list[tuple[str, str, str]]:
        """Name, value and remark of each line of numbers."""
        td: Any = self.walker.td
        x, y, height = td["true_odometry", "pelvis_position"][0].tolist()
        forward, sideways, _ = td["true_odometry", "pelvis_velocity"][0].tolist()
        commands = [f"command {value:z.2f}" for value in numbers(self.walker.command)]
        factor = "paused" if self.paused else f"real-time factor {self.factor:.2f}"
        lines = [
            ("time", f"{self.walker.time:.2f} s", factor),
            ("forward speed", f"{forward:z.2f} m/s", commands[0]),
        ]
        if "filtered_command" in td:
            yaw_rate = float(td["truth", "pelvis_angular_velocity"][0, 2])
            off_path = float(torch.linalg.vector_norm(td["true_odometry", "path_error"][0]))
            mode = WalkMode(int(td["mode"])).name.lower() if "mode" in td else ""
            lines += [
                ("sideways speed", f"{sideways:z.2f} m/s", commands[1]),
                ("yaw rate", f"{yaw_rate:z.2f} rad/s", commands[2]),
                ("off the path", f"{off_path:.2f} m", mode),
            ]
        else:
            lines.append(("moved", f"{x:z.2f} m ahead", f"{y:z.2f} m left"))
        return [*lines, ("pelvis height", f"{height:.3f} m", f"{self.falls} falls")]


def _fitting_policy(policy: str | Path, walker: Walker) -> TensorDictModuleBase:
    """Policy by its name or path, after a check that it fits the walker's environment."""
    check_policy_fits(policy, walker.env)
    return load_policy(policy)
