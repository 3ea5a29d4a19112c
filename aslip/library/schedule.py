"""Commands over time, and their command-line notation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from aslip.errors import ConfigurationError

Command = float | tuple[float, ...]
"""Forward speed [m/s]; or forward speed, sideways speed [m/s] and yaw rate [rad/s]."""


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

    def __post_init__(self) -> None:
        """Check the times.

        Raises:
            ConfigurationError: the times do not start at 0 or do not increase, there are not as
                many commands, their sizes differ, or a number is not finite.
        """
        given = f"times {self.times} and commands {self.commands}"
        if not self.times or len(self.times) != len(self.commands):
            raise ConfigurationError(f"a schedule needs as many times as commands, got {given}")
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

        A command is a forward speed, or three numbers separated by spaces.

        Raises:
            ConfigurationError: the text has another form.
        """
        try:
            if ":" not in text:
                return cls((0.0,), (_command(text),))
            pairs = [entry.split(":") for entry in text.split(",")]
            times, commands = zip(*((float(at), _command(to)) for at, to in pairs), strict=True)
        except ValueError as error:
            if isinstance(error, ConfigurationError):
                raise
            raise ConfigurationError(
                'a schedule is "time:command,..." such as "0:0.0,4:1.0,8:0.5" or'
                f' "0:0 0 0,4:0.5 0.1 -0.3", got {text!r}'
            ) from None
        return cls(times, commands)

    def at(self, time: float) -> Command:
        """Command at a time [s]."""
        # half a substep of tolerance: policy steps add up to 3.9999999 s
        return self.commands[int(np.searchsorted(self.times, time + 2.5e-4, side="right")) - 1]

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
