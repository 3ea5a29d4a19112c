"""Sources of the operator's requests: a schedule, the keyboard, datagrams of another program.

The runner asks a source at every policy step, so a source never waits.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, Final, Self

import numpy as np

from aslip.base.command_line import Reports, say
from aslip.errors import ConfigurationError, NetworkError
from aslip.library import Schedule, numbers
from aslip.network.runner.supervisor import Request
from aslip.network.wire import LOOPBACK
from aslip.network.wire.endpoint import check_port
from aslip.planning import Stones

# silence of the other program after which the robot steps in place [s]
_STOP_AFTER = 1.0
# largest speed [m/s] and yaw rate [rad/s] in a datagram, far beyond every library
_LARGEST = 100.0
# bytes of a datagram, and stones in it
_LONGEST, _MOST_STONES = 65_535, 64
# characters of a datagram that are printed
_SHOWN = 80
AXES: Final = ("forward", "sideways", "yaw_rate")
"""Components of a command, as entries of a request."""


class Source:
    """Source of requests, a context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...

    def request(self, time: float, walking: float) -> Request:
        """Present request of the operator.

        Args:
            time: time since the start of the program [s].
            walking: time since the start of the walk [s]; negative before.
        """
        raise NotImplementedError


class Scheduled(Source):
    """Requests for the commands of a schedule over the time of the walk, then for a stop.

    Args:
        schedule: forward speeds, or forward speed, sideways speed and yaw rate.
        duration: time after which the walk stops [s]; infinite by default.
    """

    def __init__(self, schedule: Schedule, duration: float = math.inf) -> None:
        self._schedule, self._duration = schedule, duration
        self.sideways = any(any(numbers(command)[1:2]) for command in schedule.commands)
        """Whether a command goes sideways."""
        self.stands = any(schedule.stands)
        """Whether the schedule has a stand command."""

    def request(self, time: float, walking: float) -> Request:
        """Request for the command that is due."""
        now, stop = max(walking, 0.0), walking >= self._duration - 1e-9
        command = dict(zip(AXES, numbers(self._schedule.at(now)), strict=False))
        return Request(stop=stop, stand=self._schedule.stand_at(now))._replace(**command)


KEYS: Final[Mapping[str, str]] = {
    "enter": "start the walk",
    "w, s": "raise, lower the forward speed by 0.1 m/s",
    "a, d": "change the yaw rate by 0.1 rad/s to the left, right",
    "q, e": "change the sideways speed by 0.1 m/s to the left, right, if the policy has one",
    "space": "step in place",
    "c": "stand, or walk again; policies that cannot stand step in place",
    ".": "stop: stand, or step in place, then damp the motors",
    "x": "damp the motors at once",
}
"""Keys of `Keyboard`."""

_CHANGES = {
    "w": ("forward", 0.1),
    "s": ("forward", -0.1),
    "a": ("yaw_rate", 0.1),
    "d": ("yaw_rate", -0.1),
    "q": ("sideways", 0.1),
    "e": ("sideways", -0.1),
}


class Keyboard(Source):
    """Requests by keys of a terminal, see `KEYS`; its settings are restored at the end.

    Args:
        descriptor: file descriptor of the terminal; standard input by default.

    Raises:
        ConfigurationError: standard input is not a terminal.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self._terminal = sys.stdin.fileno() if descriptor is None else descriptor
        # Windows has no termios
        if not os.isatty(self._terminal) or find_spec("termios") is None:
            raise ConfigurationError(
                "the keyboard needs a terminal of Linux or macOS, but standard input is not one;"
                " give --command, --schedule or --listen"
            )
        self._request = Request(walk=False)
        self._settings: list[Any] | None = None

    def __enter__(self) -> Self:
        import termios
        import tty

        self._settings = termios.tcgetattr(self._terminal)
        # single keys without echo; Ctrl-C still interrupts
        tty.setcbreak(self._terminal)
        return self

    def __exit__(self, *error: object) -> None:
        import termios

        if self._settings is not None:
            with contextlib.suppress(termios.error):  # the terminal is closed
                termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._settings)

    def request(self, time: float, walking: float) -> Request:
        """Request after all keys pressed so far.

        Raises:
            OSError: the terminal is closed.
        """
        while select.select([self._terminal], [], [], 0)[0]:
            pressed = os.read(self._terminal, 64).decode(errors="ignore")
            if not pressed:
                raise OSError("the terminal is closed")
            for key in pressed:
                self._request = press(self._request, key)
        return self._request


def press(request: Request, key: str) -> Request:
    """Request after a key; unknown keys change nothing."""
    if key in _CHANGES:
        axis, change = _CHANGES[key]
        return request._replace(**{axis: round(getattr(request, axis) + change, 6)})
    if key == " ":
        return request._replace(forward=0.0, sideways=0.0, yaw_rate=0.0)
    if key == "c":
        return request._replace(stand=not request.stand)
    if key in "\r\n":
        return request._replace(walk=True)
    if key == ".":
        return request._replace(stop=True)
    if key == "x":
        return request._replace(damp="operator: key x")
    return request


class Datagrams(Source):
    """Requests as JSON in UDP datagrams on loopback; the newest one applies.

    A datagram is an object with any of `forward`, `sideways` [m/s], `yaw_rate` [rad/s], `walk`,
    `stand`, `stop` (booleans), `damp` (text, the reason) and `stones`. Missing numbers are zero,
    and `walk` is true by default. A stop or damping counts even if a newer datagram follows at
    once. After one second without a datagram the robot steps in place.

    Stones are lists of corners [x, y, z] from the pelvis and along its yaw, level [m]; with an
    empty list the robot follows its library. They stay where they are until a datagram has others.

    Args:
        port: port on loopback; 0 lets the system choose one.
        say: function that prints why datagrams were refused, once a second at most.

    Raises:
        ConfigurationError: there is no such port.
        NetworkError: the port is in use.
    """

    def __init__(self, port: int, say: Callable[[str], object] = say) -> None:
        check_port(port)
        self._request, self._heard = Request(walk=False), -math.inf
        self._reports = Reports(say)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((LOOPBACK, port))
        except OSError as error:
            self._socket.close()
            raise NetworkError(
                f"cannot listen for commands at {LOOPBACK}:{port}: {error.strerror}; choose"
                " another port with --listen"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        """Port at which commands arrive."""

    def __exit__(self, *error: object) -> None:
        self._socket.close()

    def request(self, time: float, walking: float) -> Request:
        """Request of the newest datagram, with the stop or damping of those before it."""
        heard: list[Request] = []
        for _ in range(64):
            try:
                text = self._socket.recv(_LONGEST)
            except BlockingIOError:
                break
            try:
                heard.append(parse_request(text))
            except ConfigurationError as error:
                self._reports.add("refused", f"command refused: {error}")
        self._reports.say()
        if heard:
            damp = next((f"operator: {one.damp}" for one in heard if one.damp), "")
            stop = any(one.stop for one in heard)
            stones = next((one.stones for one in heard[::-1] if one.stones is not None), None)
            newest = heard[-1]._replace(stop=stop, damp=damp, stones=stones)
            self._request, self._heard = newest._replace(stones=None), time
            return newest
        if time - self._heard > _STOP_AFTER:
            return self._request._replace(forward=0.0, sideways=0.0, yaw_rate=0.0)
        return self._request


def parse_request(text: bytes) -> Request:
    """Read a request from JSON.

    Raises:
        ConfigurationError: the text is not a JSON object, or an entry is unknown, of another type
            or not finite.
    """
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"not JSON ({error}): {text[:_SHOWN]!r}") from None
    if not isinstance(entries, dict):
        raise ConfigurationError(
            f'a JSON object such as {{"forward": 0.5}} is needed, got {text[:_SHOWN]!r}'
        )
    for name, value in entries.items():
        if name not in Request._fields:
            raise ConfigurationError(
                f"no entry {name[:_SHOWN]!r}; there are {list(Request._fields)}"
            )
        kind: tuple[type, ...] = (int, float) if name in AXES else (bool,)
        kind = {"damp": (str,), "stones": (list,)}.get(name, kind)
        if not isinstance(value, kind) or (name in AXES and isinstance(value, bool)):
            raise ConfigurationError(
                f"{name} must be {kind[-1].__name__}, got {repr(value)[:_SHOWN]}"
            )
        if isinstance(value, int | float) and not abs(value) <= _LARGEST:
            raise ConfigurationError(
                f"{name} must be at most {_LARGEST:g}, got {repr(value)[:_SHOWN]}"
            )
    if "damp" in entries:
        # printed and logged
        shown = entries["damp"][:_SHOWN]
        entries["damp"] = "".join(c if c.isprintable() else "?" for c in shown)
    if "stones" in entries:
        entries["stones"] = _read_stones(entries["stones"])
    return Request(**entries)


def _read_stones(given: Sequence[Any]) -> np.ndarray:
    """Corners (m, e, 3) of stones, from lists of corners [x, y, z]; NaN for none.

    Raises:
        ConfigurationError: there are too many, or one is not a convex polygon of finite numbers.
    """
    if not given:
        return np.full((1, 3, 3), np.nan)
    if len(given) > _MOST_STONES:
        raise ConfigurationError(f"stones must be at most {_MOST_STONES}, got {len(given)}")
    try:
        corners = [np.array(stone, dtype=float) for stone in given]
        wrong = any(stone.ndim != 2 or stone.shape[1] != 3 for stone in corners)
    except (ValueError, TypeError):
        corners, wrong = [], True
    if wrong:
        shown = repr(given)[:_SHOWN]
        raise ConfigurationError(f"stones must be lists of corners [x, y, z], got {shown}")
    if not all((abs(stone) <= _LARGEST).all() for stone in corners):
        raise ConfigurationError(f"corners of stones must be within {_LARGEST:g} m")
    heights = [stone[:, 2].mean() for stone in corners]
    level = Stones.of([stone[:, :2] for stone in corners], heights).corners[0]
    height = np.broadcast_to(np.array(heights)[:, None, None], (*level.shape[:2], 1))
    return np.concatenate([level, height], -1)
