"""The page and its loop: one thread owns the robot and takes it through time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from aslip.errors import AslipError, ConfigurationError
from aslip.policy import load_policy
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.ghost import yaw_rotation
from aslip.show.live.controls import PUSH_DURATION, Click, Controls
from aslip.show.live.readouts import Readouts, Status
from aslip.show.live.scene import SceneView
from aslip.show.live.server import page_url, start_server
from aslip.show.pacing import Pacer
from aslip.walking import Walker

# the robot lies for so many turns of the loop before it is put up again (1 s)
_TURNS_ON_THE_GROUND = round(1.0 / CASSIE.policy_period)
# numbers change on one turn in so many (5.6 Hz); people cannot read faster
_TURNS_PER_READOUT = 6

_PANEL_WIDTH = 340


class LivePage:
    """A page on which people watch one robot walk in real time, and steer it.

    It is served from when it is made, with the robot standing; time runs within `serve`. Only the
    thread of `serve` may touch the walker then.

    Args:
        walker: the robot; its present command is the slider's first.
        policies: what there is to choose from, by name: what acts, or what `load_policy` takes.
            The first takes over from the walker's own, which alone there is by default.
        host: name or address of this machine on which to listen. Other machines see the page if
            this is "0.0.0.0"; they may steer, too, and nothing asks who they are.
        port: on which to listen; 0 for any that is free.
        on_step: is given every policy step, as `Walker.step` returns it, on the thread of `serve`.
            What it raises ends `serve`.

    Raises:
        ConfigurationError: the host is not this machine's, the port is taken or not allowed, there
            is no policy to choose from, or a policy is not one.
        AssetError: there is no policy of a name or path.
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
            raise ConfigurationError("there is no policy to choose from: policies is empty")
        self.walker = walker
        self.paused = False
        """Whether time stands still."""
        self.falls = 0
        """How often the robot has fallen."""
        self._policies = {
            name: load_policy(policy) if isinstance(policy, str | Path) else policy
            for name, policy in policies.items()
        }
        self._on_step = on_step
        self._stopping = threading.Event()
        self._serving = threading.Lock()
        self._closed = False
        self._pacer = Pacer(CASSIE.policy_period, sleep=self._stopping.wait)
        self._turns = 0
        self._turns_down = 0
        self._singles = 0
        self._complaint = ""
        self._drawn: TensorDictBase | None = None
        self._told: Status | None = None
        self._server = start_server(host, port)
        self._build()

    def _build(self) -> None:
        gui, walker = self._server.gui, self.walker
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label("Cassie, live")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_WIDTH)
        speeds = float(walker.library.speeds[0]), float(walker.library.speeds[-1])
        self.controls = Controls(
            self._server, speeds=speeds, command=walker.command, policies=list(self._policies)
        )
        """What people have set."""
        # the command is the walker's already; the rest is yet to be done
        self._asked = replace(self.controls.settings(), policy="", rom="through")
        panel = gui.add_panel()
        with panel.add_tab("Readouts"):
            self._readouts = Readouts(gui)
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH)
        # a plot that was drawn as the page opened has lost its time axis
        self._server.on_client_connect(lambda _: self._readouts.redraw())
        self._scene = SceneView(self._server, load_model(), walker.library)
        self._obey()
        self._show()

    @property
    def url(self) -> str:
        """Where a browser on this machine finds the page."""
        return page_url(self._server)

    @property
    def factor(self) -> float:
        """Simulated over real time, over the last two seconds of `serve`."""
        return self._pacer.factor

    @property
    def message(self) -> str:
        """What people are told just now; empty if all is well."""
        if not self.walker.fallen:
            return self._complaint
        then = "it starts again in a second" if self._asked.auto_reset else "click Reset"
        return f"Cassie has fallen; {then}"

    def serve(self) -> None:
        """Let time run until `stop` is called or Ctrl-C is pressed; then the page is gone.

        Raises:
            ConfigurationError: the page is being served, or was stopped.
        """
        if not self._serving.acquire(blocking=False):
            raise ConfigurationError("this page is being served already")
        try:
            if self._closed:
                raise ConfigurationError("this page was stopped; make another")
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
        """End `serve` after the turn that it is at, and close the page; from any thread."""
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
        """One period of the loop: do as people ask, walk a policy step, show it."""
        try:
            for click in self.controls.clicks():
                self._click(click)
            self._obey()
        except AslipError as error:
            self._complaint = str(error)
        if self.walker.fallen:
            self._lie()
        elif self._singles or not self.paused:
            self._singles = max(self._singles - 1, 0)
            self._step()
        self._show()

    def _click(self, click: Click) -> None:
        self._complaint = ""
        if click == "push":
            truth = cast("Mapping[str, torch.Tensor]", self.walker.td["truth"])
            heading = yaw_rotation(truth["pelvis_orientation"][0].numpy())
            self.walker.push((heading @ self.controls.push_force()).tolist(), PUSH_DURATION)
        elif click == "reset":
            self._reset()
        elif click == "step":
            self._singles += self.paused
        else:
            self.paused = not self.paused
            self._singles = 0
            self.controls.show_paused(self.paused)

    def _obey(self) -> None:
        """Do what has been set since the last turn; what nobody touched stays as it is."""
        before, self._asked = self._asked, self.controls.settings()
        asked = self._asked
        if asked != before:
            self._complaint = ""
        if asked.rom != before.rom:
            self._scene.place_rom(asked.rom)
        if asked.policy != before.policy:
            self.walker.policy = self._policies[asked.policy]
        if asked.command != before.command:
            self.walker.command = asked.command

    def _step(self) -> None:
        td = self.walker.step()
        self._readouts.add(td)
        if self.walker.fallen:
            self.falls += 1
            self._turns_down = 0
        if self._on_step is not None:
            self._on_step(td)

    def _lie(self) -> None:
        """Wait a while on the ground, then start again."""
        if self._asked.auto_reset and not self.paused:
            self._turns_down += 1
            if self._turns_down >= _TURNS_ON_THE_GROUND:
                self._reset()

    def _reset(self) -> None:
        self.walker.reset()
        self._singles = 0

    def _show(self) -> None:
        """Send what is new: the scene at once, numbers on some turns only."""
        td = self.walker.td
        if td is not self._drawn:
            self._scene.update(td)
            self._drawn = td
        if self._turns % _TURNS_PER_READOUT == 0:
            status = self._status()
            if status != self._told:
                self._readouts.show(status)
                self._told = status
        self._turns += 1

    def _status(self) -> Status:
        body = cast("Mapping[str, torch.Tensor]", self.walker.td["true_odometry"])
        return Status(
            time=self.walker.time,
            speed=float(body["pelvis_velocity"][0, 0]),
            height=float(body["pelvis_position"][0, 2]),
            ahead=float(body["pelvis_position"][0, 0]),
            left=float(body["pelvis_position"][0, 1]),
            falls=self.falls,
            factor=None if self.paused else self.factor,
            message=self.message,
        )
