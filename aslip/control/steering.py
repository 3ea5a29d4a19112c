"""Clock, filtered command and reference of robots, with the functions of the training stacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.transforms.balance import find_balance
from aslip.transforms.clock import advance_phase
from aslip.transforms.command import approach_command
from aslip.transforms.reference import reference_and_target
from aslip.transforms.standing import (
    advance_mode,
    check_rates_of_stops,
    first_mode,
    required_transitions,
    stop_rates,
    stop_target,
)


@dataclass(frozen=True, eq=False)
class Steering:
    """Motion that robots follow, from their commands and stand commands.

    The clock is that of `PhaseClock`, with several axes of the command behind the filter
    `CommandFilter`. Robots that take stand commands have `StandClock` and `StandFilter`.

    Raises:
        ConfigurationError: `stands` is true, and the library has no stop and start, or one axis,
            or there are not three rates.
    """

    library: GaitLibrary
    """Gaits."""
    rates: tuple[float, ...]
    """Largest rates of the filtered command [m/s^2, rad/s^2]."""
    stands: bool
    """True for robots that take stand commands."""
    motor_lead: float
    """Lead of the motor references over the phase, in policy steps."""

    def __post_init__(self) -> None:
        """Check that the library has what standing needs."""
        if self.stands:
            required_transitions(self.library)
            if not self.along_path:
                raise ConfigurationError(
                    "standing needs a library over several commands, got one over forward speed"
                )
            check_rates_of_stops(self.rates)

    @property
    def along_path(self) -> bool:
        """True if robots follow a filtered command, along its path."""
        return self.library.command_size > 1

    def begin(self, command: Tensor, phase: Tensor, stand: Tensor | None) -> dict[str, Tensor]:
        """Entries (n, k) of robots that begin, see `advance`.

        Args:
            command: (n, c) command.
            phase: (n, 1) stride fraction.
            stand: (n, 1) stand command; None for robots that only walk.
        """
        phase, mode, filtered = phase % 1.0, None, command
        if stand is not None:
            phase, mode = first_mode(required_transitions(self.library), phase, stand)
            filtered = stop_target(command, stand, mode)
        entries = self._entries(command, phase, stand, mode)
        if self.along_path:
            entries["filtered_command"] = filtered.clone()
        return entries

    def advance(
        self, past: Mapping[str, Any], command: Tensor, stand: Tensor | None
    ) -> dict[str, Tensor]:
        """Entries (n, k) a policy step later.

        Args:
            past: `phase`, and `filtered_command` and `mode` where `begin` returned them; for robots
                that stand the `estimate`, too.
            command: (n, c) command during the step.
            stand: (n, 1) stand command during the step; None for robots that only walk.

        Returns:
            `command` and `phase`; with several axes of the command `filtered_command`; for robots
            that stand `stand` and `mode`, values of `aslip.library.WalkMode`.
        """
        phase, mode = past["phase"], None
        filtered = past["filtered_command"] if self.along_path else command
        if stand is None:
            phase = advance_phase(self.library, phase, filtered)
        else:
            mode = past["mode"]
            balance = find_balance(past["estimate"])
            phase, mode = advance_mode(self.library, phase, mode, filtered, stand, balance=balance)
        entries = self._entries(command, phase, stand, mode)
        if self.along_path:
            aim, rates = command, self.rates
            if stand is not None:
                aim = stop_target(command, stand, past["mode"])
                rates = stop_rates(self.rates, stand, past["mode"])
            entries["filtered_command"] = approach_command(filtered, aim, rates)
        return entries

    def reference(self, present: Mapping[str, Any]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Entries of the reference and of the target, see `ReferenceInjection`.

        Args:
            present: entries that `begin` or `advance` returned.
        """
        filtered = present["filtered_command" if self.along_path else "command"]
        standing = (present["mode"], present["stand"]) if self.stands else None
        return reference_and_target(
            self.library,
            filtered,
            present["phase"],
            motor_lead=self.motor_lead,
            standing=standing,
        )

    @on_cpu_in_single
    def pose(self) -> Tensor:
        """Motor angles (m,) of the reference when robots begin, standing if they can [rad]."""
        phase = torch.zeros(1, 1)
        still = torch.zeros(1, self.library.command_size)
        present = self.begin(still, phase, torch.ones(1, 1) if self.stands else None)
        mode = present.get("mode", None)
        return self.library.lookup(present["phase"], still, mode).motor_position[0]

    @staticmethod
    def _entries(
        command: Tensor, phase: Tensor, stand: Tensor | None, mode: Tensor | None
    ) -> dict[str, Tensor]:
        entries = {"command": command, "phase": phase}
        if stand is not None and mode is not None:
            entries |= {"stand": stand, "mode": mode}
        return entries
