"""Page of the twin: pictures go out, pushes and stops come back."""

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from threading import Thread
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.network.twin import TwinRobot
from aslip.network.twin import page as twin_page
from aslip.network.wire import STOP_CHANNEL, command_to_pd_in
from aslip.robot import CASSIE

HOLD = command_to_pd_in(CASSIE.standing[CASSIE.indices.motor_qpos])


class Page:
    """Page without a browser."""

    url = "http://127.0.0.1:1"

    def __init__(self, host: str, port: int) -> None:
        if port == 1:
            raise ConfigurationError(f"port {port} on {host} is taken")
        self.shown: list[tuple[np.ndarray, Mapping[str, str]]] = []
        self.clicked: list[np.ndarray] = []
        self.stop = SimpleNamespace(value=False)
        Page.opened, self.closed = self, False

    def show(self, qpos: np.ndarray, lines: Mapping[str, str]) -> None:
        self.shown.append((qpos, lines))

    def forces(self) -> Iterator[np.ndarray]:
        while self.clicked:
            yield self.clicked.pop()

    def close(self) -> None:
        self.closed = True

    opened: "Page"


@pytest.fixture
def in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Serve the page in a thread instead of a process."""

    def process(target: Callable[..., None], args: tuple[Any, ...], daemon: bool) -> Thread:
        # a process has its own end of the pipe
        pipe = Connection(os.dup(args[0].fileno()))
        return Thread(target=target, args=(pipe, *args[1:]), daemon=daemon)

    context = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=process)
    monkeypatch.setattr(twin_page, "Spawned", lambda: context)
    monkeypatch.setattr(twin_page.signal, "signal", lambda *_: None)
    live, pushes = ModuleType("aslip.show.live"), ModuleType("aslip.show.live.pushes")
    monkeypatch.setitem(sys.modules, live.__name__, live)
    monkeypatch.setitem(sys.modules, pushes.__name__, pushes)
    monkeypatch.setattr(live, "RobotPage", Page, raising=False)
    monkeypatch.setattr(pushes, "PUSH_DURATION", 0.01, raising=False)


def _until(turn: Callable[[], object], done: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not done():
        assert time.monotonic() < end
        turn()
        time.sleep(0.005)


def test_the_page_shows_pushes_and_stops_the_robot(in_a_thread: None) -> None:
    robot = TwinRobot()
    page = twin_page.TwinPage(robot, port=0)
    assert page.url == Page.url
    turn = lambda: page.update({"client": "none yet"})  # noqa: E731
    _until(turn, lambda: bool(Page.opened.shown))
    qpos, lines = Page.opened.shown[-1]
    np.testing.assert_array_equal(qpos, robot.truth()["qpos"][0])
    assert lines == {"time": "0.00 s since the start", "client": "none yet"}

    Page.opened.clicked.append(np.array([0.0, 300.0, 0.0]))
    Page.opened.stop.value = True
    _until(turn, lambda: robot.stopped)
    robot.tick(HOLD)
    assert abs(robot.truth()["pelvis_acceleration"][0, 1]) > 1.0
    Page.opened.stop.value = False
    _until(turn, lambda: not robot.stopped)

    # the switch of the page overrides other radios only when it changes
    robot.radio[STOP_CHANNEL] = -1
    shown = len(Page.opened.shown)
    _until(turn, lambda: len(Page.opened.shown) > shown + 1)
    assert robot.stopped
    page.close()
    _until(lambda: None, lambda: Page.opened.closed)


def test_a_page_that_cannot_start_is_an_error(in_a_thread: None) -> None:
    with pytest.raises(ConfigurationError, match=r"port 1 on 127\.0\.0\.1 is taken"):
        twin_page.TwinPage(TwinRobot(), port=1)
