"""Standing on command: the stand command, and the clock of walk, stop, standing and start.

In a stack, in this order:

    "command_filter": StandFilter(),
    "clock": StandClock(library),
    "stand": StandCommand(),
    "reference": ReferenceInjection(
        library, in_keys=["filtered_command", "phase", "mode", "stand"]
    ),
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary, TransitionTable, WalkMode
from aslip.library.transitions import HALF
from aslip.robot import CASSIE
from aslip.transforms.balance import Balance, find_balance
from aslip.transforms.base import (
    ChosenAtReset,
    check_interval,
    checked_column,
    require_keys,
)
from aslip.transforms.command import COMMAND_RATES, CommandFilter

STOP_RATES: Final = (1.5, 0.75, 1.0)
"""Rates of the filtered command in stops, for robots whose own are lower: forward, sideways speed
[m/s^2], yaw rate [rad/s^2]."""

_ROUNDING = 1e-6  # of a phase in single precision


def advance_mode(
    library: GaitLibrary,
    phase: Tensor,
    mode: Tensor,
    command: Tensor,
    stand: Tensor,
    period: float = CASSIE.policy_period,
    balance: Balance | None = None,
) -> tuple[Tensor, Tensor]:
    """Stride fraction (*b, 1) and mode (*b, 1) some time later; see `aslip.library.transitions`.

    A stop begins at a touchdown, if the stand command is 1 and the robot steps in place and is
    steady by then. It ends in standing, which lasts as long as the stand command is 1; then a start
    leads back to the gait in place. No stop or start is broken off. Changes of mode within `period`
    are exact. A robot that stands and is not steady any more steps at once, with the foot that it
    does not lean to, and walks on.

    Args:
        library: gaits with transitions.
        phase: (*b, 1) stride fraction.
        mode: (*b, 1) values of `WalkMode`, of any type.
        command: (*b, c) one value per axis of the library, that clock and reference follow.
        stand: (*b, 1) 1 to stand, 0 to walk.
        period: time, shorter than a single stance, a stop and a start [s].
        balance: whether robots are steady; they are by default.

    Raises:
        ConfigurationError: the library has no transitions.
    """
    table = required_transitions(library)
    within = phase.double() % 1.0
    half = torch.where(within >= HALF, HALF, 0.0)
    within, stays = within - half, stand > 0.5
    if balance is not None:
        tips = (mode == WalkMode.STAND) & ~balance.steady
        mode = torch.where(tips, WalkMode.WALK, mode)
        # the left foot lifts off at phase 0, the right one half a stride later
        half = torch.where(tips, torch.where(balance.leans_left, HALF, 0.0), half)
        within, stays = torch.where(tips, 0.0, within), stays & balance.steady
    mode = torch.where((mode == WalkMode.STAND) & ~stays, WalkMode.START, mode)
    walking = 1 / library.stride(command).double()
    in_place = (command == 0).all(-1, keepdim=True)
    lands = stays & in_place & (within <= table.touchdown)
    end = _chosen(
        mode,
        torch.where(lands, table.touchdown, math.inf),
        *(table.standing, math.inf, HALF),
    )
    rate = _rate(table, mode, walking)
    # a tensor, because exporters round other numbers to single precision
    moved = within + torch.tensor(period, dtype=torch.float64) * rate
    passed = moved >= end - _ROUNDING
    spare = torch.where(passed, moved - end, 0.0).clamp(min=0.0) / rate.clamp(min=_ROUNDING)
    following = _chosen(mode, WalkMode.STOP, WalkMode.STAND, WalkMode.STAND, WalkMode.WALK)
    mode = torch.where(passed, following.to(mode.dtype), mode)
    moved = torch.where(passed, end + spare * _rate(table, mode, walking), moved)
    return ((half + moved) % 1.0).to(phase.dtype), mode


def required_transitions(library: GaitLibrary) -> TransitionTable:
    """Stop and start of a library.

    Raises:
        ConfigurationError: it has none.
    """
    if library.transitions is None:
        raise ConfigurationError(
            "standing needs a library with stop and start, as `aslip gaits directions` builds"
        )
    return library.transitions


def standing_phase(table: TransitionTable, phase: Tensor) -> Tensor:
    """Phase (*b, 1) at which a robot stands, in the half of the stride of a phase (*b, 1)."""
    return torch.where(phase % 1.0 >= HALF, HALF + table.standing, table.standing).to(phase.dtype)


def first_mode(table: TransitionTable, phase: Tensor, stand: Tensor) -> tuple[Tensor, Tensor]:
    """Phase (*b, 1) and mode (*b, 1) of robots that start an episode: they stand, or walk.

    Args:
        table: stop and start.
        phase: (*b, 1) stride fraction in [0, 1).
        stand: (*b, 1) 1 to stand, 0 to walk.
    """
    stays = stand > 0.5
    modes = torch.where(stays, float(WalkMode.STAND), float(WalkMode.WALK))
    return torch.where(stays, standing_phase(table, phase), phase), modes


def stop_target(command: Tensor, stand: Tensor, mode: Tensor) -> Tensor:
    """Command (*b, c) of robots that walk without a stand command, zero for the others.

    Args:
        command: (*b, c) one value per axis of the library.
        stand: (*b, 1) 1 to stand, 0 to walk.
        mode: (*b, 1) values of `WalkMode`.
    """
    return torch.where(_walks(stand, mode), command, torch.zeros_like(command))


def stop_rates(rates: Sequence[float], stand: Tensor, mode: Tensor) -> Tensor:
    """Largest rates (*b, 3) of the filtered command: at least `STOP_RATES` for robots that stop.

    Args:
        rates: forward, sideways speed [m/s^2] and yaw rate [rad/s^2].
        stand: (*b, 1) 1 to stand, 0 to walk.
        mode: (*b, 1) values of `WalkMode`.
    """
    own, stop = (torch.tensor(some, dtype=torch.float64) for some in (rates, STOP_RATES))
    return torch.where(_walks(stand, mode), own, own.maximum(stop))


def check_rates_of_stops(rates: Sequence[float]) -> None:
    """Check that there is one rate for each one of `STOP_RATES`.

    Raises:
        ConfigurationError: there is not.
    """
    if len(rates) != len(STOP_RATES):
        raise ConfigurationError(
            f"robots that stand need {len(STOP_RATES)} rates of the command, got {len(rates)}"
        )


def _walks(stand: Tensor, mode: Tensor) -> Tensor:
    """Whether robots walk without a stand command (*b, 1)."""
    return (mode == WalkMode.WALK) & (stand <= 0.5)


def _rate(table: TransitionTable, mode: Tensor, walking: Tensor) -> Tensor:
    """Phase per second (*b, 1) in each mode [1/s]."""
    stop, start = table.rates
    return _chosen(mode, walking, stop, 0.0, start)


def _chosen(mode: Tensor, *values: Tensor | float) -> Tensor:
    """Value (*b, 1) of each robot's mode, in double precision."""
    chosen = torch.zeros_like(mode, dtype=torch.float64)
    for one, value in zip(WalkMode, values, strict=True):
        chosen = torch.where(mode == one, torch.as_tensor(value, dtype=chosen.dtype), chosen)
    return chosen


class StandCommand(ChosenAtReset):
    """Draw the stand command at each reset, and at random times if `interval` is finite.

    It is `stand` (n, 1): 1 to stand, 0 to walk. To choose yourself, write `td["stand"]` between
    steps, or pass it to `env.reset`. A partial reset (with a `_reset` mask) draws for the reset
    robots only.

    Args:
        share: share of draws that are 1.
        interval: mean time between draws within an episode [s].

    Raises:
        ConfigurationError: `share` is no share, or `interval` is shorter than a policy step.
    """

    needs_env = "it draws stand commands at resets"

    def __init__(self, share: float = 0.1, interval: float = math.inf) -> None:
        super().__init__([], {"stand": 1})
        self.share = check_number("share", share, 0, 1)
        self.interval = check_interval(interval)

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        shape = (*request.batch_size, 1)
        return {"stand": (torch.rand(shape, generator=self.generator) < self.share).float()}

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        return request.set("stand", checked_column(request, "stand"))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        stand = checked_column(tensordict, "stand")
        if math.isfinite(self.interval):
            chance = torch.rand(stand.shape, generator=self.generator)
            changes = chance < CASSIE.policy_period / self.interval
            stand = torch.where(changes, self._drawn(tensordict)["stand"], stand)
        return next_tensordict.set("stand", stand)


class StandClock(ChosenAtReset):
    """Advance the phase and the mode of walk, stop, standing and start; see `advance_mode`.

    It takes the place of `PhaseClock`, and writes `phase` and `mode` (n, 1), values of `WalkMode`
    in single precision. Robots with a stand command at a reset start with standing, the others
    walk, all at a drawn phase; a mode can be set between steps, but not at a reset. The entry
    `estimate` determines whether robots are steady (`find_balance`); in a stack without an
    estimator they always are.

    Args:
        library: gaits with transitions.
        command_key: key of the command (n, c) that clock and reference follow.

    Raises:
        ConfigurationError: the library has no transitions.
    """

    needs_env = "it draws phases at resets"

    def __init__(self, library: GaitLibrary, command_key: NestedKey = "filtered_command") -> None:
        super().__init__([command_key, "stand", "estimate"], {"phase": 1, "mode": 1})
        self._table = required_transitions(library)
        self.library = library

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        return {"phase": torch.rand((*request.batch_size, 1), generator=self.generator)}

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        phase, stand = (checked_column(request, key) for key in ("phase", "stand"))
        phase, mode = first_mode(self._table, phase % 1.0, stand)
        return request.set("phase", phase).set("mode", mode)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = checked_column(tensordict, self.in_keys[0], self.library.command_size)
        phase, mode, stand = (checked_column(tensordict, key) for key in ("phase", "mode", "stand"))
        estimate = tensordict.get("estimate", None)
        balance = None if estimate is None else find_balance(estimate)
        phase, mode = advance_mode(self.library, phase, mode, command, stand, balance=balance)
        return next_tensordict.set("phase", phase).set("mode", mode)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add phase and mode; the stand command comes later in the stack."""
        require_keys(self, observation_spec, self.in_keys[:1])
        return super().transform_observation_spec(observation_spec)


class StandFilter(CommandFilter):
    """Limit the rate of the command, and lead it to zero to stand; see `CommandFilter`.

    The filtered command approaches zero while the stand command is 1, and stays there until the
    robot walks again. It takes the place of `CommandFilter`, before `StandClock` in the stack.

    Args:
        rates: largest change of forward speed, sideways speed [m/s^2] and yaw rate [rad/s^2];
            stops are at least as fast as `STOP_RATES`.

    Raises:
        ConfigurationError: a rate is not a positive finite number, or there are not three.
    """

    _reads = ("command", "stand", "mode")

    def __init__(self, rates: Sequence[float] = COMMAND_RATES) -> None:
        super().__init__(rates)
        check_rates_of_stops(self.rates)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # in a stack, later transforms write the other entries: until then they are in the request
        known = tensordict if tensordict_reset.get("mode", None) is None else tensordict_reset
        command = stop_target(tensordict_reset["command"], known["stand"], known["mode"])
        return tensordict_reset.set("filtered_command", command.clone())

    def _aim(self, tensordict: TensorDictBase, command: Tensor) -> Tensor:
        return stop_target(command, *(tensordict[key] for key in self.in_keys[1:]))

    def _rates(self, tensordict: TensorDictBase) -> Tensor:
        return stop_rates(self.rates, *(tensordict[key] for key in self.in_keys[1:]))
