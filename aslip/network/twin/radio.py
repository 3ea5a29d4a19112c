"""Operator's radio of the twin, whose channels are set by lines of text."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterable

from aslip.base.command_line import say
from aslip.errors import ConfigurationError
from aslip.network.twin.robot import TwinRobot


def read_radio(robot: TwinRobot, lines: Iterable[str] | None = None) -> threading.Thread:
    """Set channels of a robot's radio from lines of text, on a separate thread.

    Args:
        robot: robot that hears the radio.
        lines: lines "CHANNEL VALUE"; by default those typed into the terminal.

    Returns:
        The thread; it ends with the lines, and does not keep the program alive.
    """

    def listen() -> None:
        for line in sys.stdin if lines is None else lines:
            try:
                channel, value = parse_channel(line, len(robot.radio))
            except ConfigurationError as error:
                say(f"radio: {error}")
                continue
            robot.radio[channel] = value

    thread = threading.Thread(target=listen, name="radio", daemon=True)
    thread.start()
    return thread


def parse_channel(line: str, channels: int = 16) -> tuple[int, float]:
    """Read a channel and its value from a line such as "8 -1".

    Raises:
        ConfigurationError: the line has another form, there is no such channel, or the value is
            not between -1 and 1.
    """
    try:
        channel, value = int(line.split()[0]), float(" ".join(line.split()[1:]))
    except (IndexError, ValueError):
        raise ConfigurationError(
            f'a line "CHANNEL VALUE" such as "8 -1" is needed, got {line.strip()!r}'
        ) from None
    if not 0 <= channel < channels:
        raise ConfigurationError(f"a channel is between 0 and {channels - 1}, got {channel}")
    if not (math.isfinite(value) and abs(value) <= 1):
        raise ConfigurationError(f"a channel's value is between -1 and 1, got {value:g}")
    return channel, value
