"""Commands over time, and their command-line notation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aslip.errors import ConfigurationError

Command = float | tuple[float, ...]
"""Forward speed [m/s]; or forward speed, sideways speed [m/s] and yaw rate [rad/s]."""

STAND: Final = "stand"
"""Word of a schedule for the stand command."""


def numbers(command: Command) -> tuple[float, ...]:
    """Components of a command."""
    return command if isinstance(command, tuple) else (command,)


@dataclass(frozen=True)
class Schedule:
    """Commands over time, each held until the next."""

    times: tuple[float, ...]
    """Start time of each command [s], ascending from 0."""
    commands: tuple[Command, ...]
    """Commands of one size."""
    stands: tuple[bool, ...] = ()
    """True where the robot is to stand, at a zero command; empty if it never is."""

    def __post_init__(self) -> None:
        """Check the times.

        Raises:
            ConfigurationError: the times do not start at 0 or do not increase, there are not as
                many commands, their sizes differ, or a number is not finite.
        """
        given = f"times {self.times} and commands {self.commands}"
        if not self.times or len(self.times) != len(self.commands):
            raise ConfigurationError(f"a schedule needs as many times as commands, got {given}")
        if len(self.stands) not in (0, len(self.times)):
            raise ConfigurationError(
                f"a schedule needs as many stand commands as commands, got {self.stands}"
            )
        components = [number for command in self.commands for number in numbers(command)]
        if not all(map(math.isfinite, (*self.times, *components))):
            raise ConfigurationError(f"a schedule needs finite numbers, got {given}")
        if len({len(numbers(command)) for command in self.commands}) > 1:
            raise ConfigurationError(f"a schedule needs commands of one size, got {given}")
        if self.times[0] != 0 or any(np.diff(self.times) <= 0):
            raise ConfigurationError(f"times of a schedule must increase from 0, got {given}")

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """Read "time:command,time:command,...", or a single command.

        A command is a forward speed, three numbers separated by spaces, or the word "stand".

        Raises:
            ConfigurationError: the text has another form.
        """
        try:
            pairs = [("0", text)]
            if ":" in text:
                pairs = [entry.split(":") for entry in text.split(",")]
            times, words = zip(*((float(at), to.strip()) for at, to in pairs), strict=True)
            stands = tuple(word == STAND for word in words)
            moves = [_command(word) for word in words if word != STAND] or [0.0]
            rest = (0.0,) * len(moves[0]) if isinstance(moves[0], tuple) else 0.0
            waiting = iter(moves)
            commands = tuple(rest if stays else next(waiting) for stays in stands)
        except ValueError as error:
            if isinstance(error, ConfigurationError):
                raise
            raise ConfigurationError(
                'a schedule is "time:command,..." such as "0:0.0,4:1.0,8:0.5" or'
                f' "0:0 0 0,4:0.5 0.1 -0.3,8:stand", got {text!r}'
            ) from None
        return cls(times, commands, stands if any(stands) else ())

    def at(self, time: float) -> Command:
        """Command at a time [s]."""
        return self.commands[self._index(time)]

    def stand_at(self, time: float) -> bool:
        """Whether the robot is to stand at a time [s]."""
        return bool(self.stands) and self.stands[self._index(time)]

    def _index(self, time: float) -> int:
        # half a substep of tolerance: policy steps add up to 3.9999999 s
        return int(np.searchsorted(self.times, time + 2.5e-4, side="right")) - 1

    def of_size(self, size: int) -> Schedule:
        """Schedule whose single forward speeds become commands of `size` numbers, the others 0."""
        if size == 1 or any(isinstance(command, tuple) for command in self.commands):
            return self
        rest = (0.0,) * (size - 1)
        return replace(self, commands=tuple((*numbers(c), *rest) for c in self.commands))


def _command(text: str) -> Command:
    """Command of one number or three numbers.

    Raises:
        ValueError: the text has another form.
    """
    components = tuple(map(float, text.split()))
    if len(components) not in (1, 3):
        raise ValueError(text)
    return components[0] if len(components) == 1 else components
