"""Replay: simulate a log again, and compare with every logged state."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from aslip.base.assets import user_path
from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.log.frozen_model import (
    LONGEST_MEMORY,
    is_known,
    low_level_digest,
    model_digest,
    thaw_model,
)
from aslip.log.messages import MEMORY
from aslip.log.reader import Recording, Series, read
from aslip.robot import CASSIE
from aslip.sim import DYNAMICS, Dynamics, Simulations
from aslip.sim.course import STONE
from aslip.sim.dynamics import with_memory_of
from aslip.sim.stones import PlacedStones

TOPICS = ("/step", "/state", "/dynamics", "/stones")
"""Topics that a replay reads."""

_ONE = np.zeros(1, dtype=int)
_Value = TypeVar("_Value")
# parameters that logs of earlier versions lack
_GAINS = ("pd_stiffness", "pd_damping")


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    start: float
    """Log time of the first state [s]."""
    steps: int
    """Policy steps that were simulated."""
    compared: int
    """Number of logged states with which the simulation was compared."""
    diverged_at: float | None
    """Log time of the first state that differs in a bit [s]; None if all are equal."""
    largest_difference: float
    """Largest difference of the configuration in these states [m, rad]."""
    doubts: tuple[str, ...]
    """Reasons why the simulation may differ: MuJoCo, the model or the low level is another one."""

    @property
    def equal(self) -> bool:
        """True if every compared state is bit-equal."""
        return self.diverged_at is None


def replay(
    log: str | Path | Recording, start: float = 0.0, *, model: str | Path | None = None
) -> Replay:
    """Simulate a log again with its motor targets and pushes, and compare with its states.

    Every episode starts from a logged state, and so does the part after a gap in the steps. Replay
    only logs that you trust: their numbers are simulated as they are.

    Args:
        log: a recording, or the path of a log.
        start: time [s]; the replay starts from the last logged state at or before it.
        model: MJCF of the robot; by default the shipped one, if the log names it by its hash.

    Raises:
        FileDamagedError: the log is damaged.
        UnknownNameError: the log has no states, steps or dynamics.
        ConfigurationError: the log is of another model, and `model` is not given; or the log has no
            state at or before `start`, or no policy step after that state.
    """
    recording = log if isinstance(log, Recording) else read(log, TOPICS)
    try:
        robot = ReplayedRobot(recording, None if model is None else user_path(model))
        run = _Run(recording, robot, start)
        run.simulate()
        return run.result(_doubts(recording, robot))
    except AslipError as error:
        raise type(error)(f"cannot replay {str(recording.path)!r}: {error}") from error


class _Run:
    """Replay from one state of a log."""

    def __init__(self, recording: Recording, robot: ReplayedRobot, start: float) -> None:
        self._robot, self._start = robot, start
        states, steps = recording["/state"], recording["/step"]
        self._rows = robot.rows(states)
        self._ticks = steps.ticks
        targets = [steps.numbers(f"motor_target_{motor}") for motor in CASSIE.motor_names]
        self._targets = np.stack(targets, axis=1)
        self._pushes = np.stack([steps.numbers(f"push_{axis}") for axis in "xyz"], axis=1)
        before = np.flatnonzero(states.time <= start + 1e-9)
        if len(before) == 0:
            raise ConfigurationError(
                f"the log begins at {states.time[0]:g} s; it has no state at {start:g} s"
            )
        self._known = {int(tick): i for i, tick in enumerate(states.ticks) if i >= before[-1]}
        self._first = int(states.ticks[before[-1]])
        self._steps = 0
        self._compared: list[tuple[int, bool, float]] = []

    def simulate(self) -> None:
        """Simulate all policy steps, and compare with the logged states."""
        robot, reached = self._robot, self._first
        robot.set_state(self._rows[self._known[reached]])
        for i in np.flatnonzero(self._ticks > self._first):
            tick = int(self._ticks[i])
            if tick - 1 != reached:  # an episode begins, or a recovered log has a gap
                if tick - 1 not in self._known:
                    continue
                robot.set_state(self._rows[self._known[tick - 1]])
            robot.change(tick - 1)
            robot.advance(self._targets[i], self._pushes[i])
            reached = tick
            self._steps += 1
            if tick in self._known:
                self._compare(tick)

    def _compare(self, tick: int) -> None:
        """Compare the present state with the logged one."""
        row = self._rows[self._known[tick]]
        state = self._robot.state(row)
        # `time` comes first in the state, then `qpos`
        qpos = slice(1, 1 + self._robot.model.nq)
        difference = float(np.abs(state[qpos] - row[qpos]).max())
        self._compared.append((tick, state.tobytes() == row.tobytes(), difference))

    def result(self, doubts: tuple[str, ...]) -> Replay:
        """Result of the replay.

        Raises:
            ConfigurationError: no step was simulated.
        """
        if not self._steps:
            raise ConfigurationError(
                f"no policy step follows the state at {self._first * CASSIE.policy_period:g} s, the"
                f" last one before {self._start:g} s"
            )
        differ = [tick for tick, equal, _ in self._compared if not equal]
        return Replay(
            start=self._first * CASSIE.policy_period,
            steps=self._steps,
            compared=len(self._compared),
            diverged_at=differ[0] * CASSIE.policy_period if differ else None,
            largest_difference=max((size for _, _, size in self._compared), default=0.0),
            doubts=doubts,
        )


def _doubts(recording: Recording, robot: ReplayedRobot) -> tuple[str, ...]:
    """Entries of the metadata that are others here; a simulation may then not be bit-equal."""
    here = {
        "version/mujoco": importlib.metadata.version("mujoco"),
        "model_digest": model_digest(robot.model),
        "low_level_digest": low_level_digest(),
    }
    logged = recording.metadata
    return tuple(
        f"{name} is {logged.get(name)} in the log, and {text} here"
        for name, text in here.items()
        if logged.get(name) != text
    )


class ReplayedRobot:
    """Simulation of a logged robot.

    Args:
        recording: log whose `/dynamics` begins no later than the first state of a replay.
        path: MJCF of the robot; by default the shipped one, if the log names it.

    Raises:
        ConfigurationError: the log is of another model, and `path` is not given.
        FileDamagedError: the model cannot be compiled, or the log's dynamics are not numbers.
    """

    def __init__(self, recording: Recording, path: Path | None = None) -> None:
        self._thaw = partial(thaw_model, recording, path)
        self.model = self._thaw()
        """Model of the robot at the beginning of the log."""
        if path is None and not is_known(recording, self.model):
            raise ConfigurationError(
                f"the log is of another model than {CASSIE.mjcf.name}; give the MJCF of a log that"
                ' you trust as `model`, such as its attachment "model.xml"'
            )
        self._memory = self._shortest = int(self.model.actuator_history[0, 0])
        self._changes = _changes(recording["/dynamics"])
        self._dynamics = Dynamics(1, self.model)
        self._stones = PlacedStones(1, self.model)
        self._courses = _courses(recording.series.get("/stones"))
        self._simulations = Simulations(1, model=self.model, num_threads=1)
        self._size = self._simulations.states().shape[1]

    def rows(self, states: Series) -> list[np.ndarray]:
        """States of `/state`, as `set_state` takes them."""
        pairs = zip(states["integration"], states["sensors"], strict=True)
        return [np.concatenate([np.ravel(part) for part in pair]) for pair in pairs]

    def change(self, tick: int) -> None:
        """Set the last dynamics and stones that were logged at or before an instant.

        Raises:
            FileDamagedError: dynamics or stones are missing or out of range.
        """
        values = dict(_last(self._changes, tick, "/dynamics"))
        self._lengthen(self._checked_memory(values.pop(MEMORY)))
        at = f"{tick * CASSIE.policy_period:g} s"
        try:
            fields = self._dynamics.update(_ONE, values)
        except ValueError as error:
            raise FileDamagedError(f"/dynamics at {at}: {error}") from error
        self._simulations.write_fields(_ONE, fields)
        if not self._courses:
            return
        rows = _last(self._courses, tick, "/stones")
        if np.array_equal(rows, self._stones.rows, equal_nan=True):
            return
        try:
            self._stones.place_rows(_ONE, rows)
        except ValueError as error:
            raise FileDamagedError(f"/stones at {at}: {error}") from error
        if not self._stones.fit:
            raise FileDamagedError(f"/stones at {at}: more stones than the model of the log has")
        self._simulations.write_fields(_ONE, self._stones.fields(_ONE))

    def set_state(self, row: np.ndarray) -> None:
        """Set a logged state."""
        memory = self._memory_of(row)
        self._lengthen(memory)
        state = self._converted(row[None], memory, self._memory)
        self._simulations.set_states(state)

    def state(self, row: np.ndarray) -> np.ndarray:
        """State of the robot, with the length of a logged one."""
        self._lengthen(self._memory_of(row))
        return self._simulations.states()[0]

    def advance(self, target: np.ndarray, push: np.ndarray) -> None:
        """Simulate a policy step."""
        self._simulations.advance(target[None], push[None])

    # -------------------------------------------------- memory of commands

    def _memory_of(self, row: np.ndarray) -> int:
        """Number of torque commands in the memory of a state, from its length.

        Raises:
            FileDamagedError: the length is not that of a state of this robot.
        """
        more, rest = divmod(len(row) - self._size, 2 * self.model.nu)
        if rest:
            raise FileDamagedError(f"a state of the log has {len(row)} numbers, not {self._size}")
        return self._checked_memory(self._shortest + more)

    def _checked_memory(self, memory: float) -> int:
        lengths = [self._shortest * 2**i for i in range(LONGEST_MEMORY.bit_length())]
        if memory > LONGEST_MEMORY or memory not in lengths:
            raise FileDamagedError(f"a motor cannot remember {memory:g} torque commands")
        return int(memory)

    def _lengthen(self, memory: int) -> None:
        """Continue in a simulation with a longer memory of commands, as `SimulatedEnv` does."""
        if memory <= self._memory:
            return
        states = self._converted(self._simulations.states(), self._memory, memory)
        model = self._thaw(memory)
        self._simulations = Simulations(1, model=model, num_threads=1)
        self._simulations.write_fields(_ONE, self._dynamics.fields(_ONE))
        if self._courses:
            self._simulations.write_fields(_ONE, self._stones.fields(_ONE))
        self._simulations.set_states(states)
        self._memory = memory

    def _converted(self, states: np.ndarray, memory: int, to: int) -> np.ndarray:
        """Convert states to a memory of `to` commands."""
        if memory == to:
            return states
        models = (self._thaw(number) for number in (memory, to))
        return with_memory_of(states, *models)


def _last(changes: Mapping[int, _Value], tick: int, topic: str) -> _Value:
    """Value of the last change at or before a policy step.

    Raises:
        FileDamagedError: the changes of the topic begin later.
    """
    past = [at for at in changes if at <= tick]
    if not past:
        raise FileDamagedError(f"{topic} does not begin before {tick * CASSIE.policy_period:g} s")
    return changes[max(past)]


def _courses(series: Series | None) -> dict[int, np.ndarray]:
    """Policy step -> stones (1, s, 6) that there are from then on."""
    if series is None:
        return {}
    rows = np.stack([series[name] for name in STONE], -1)[:, None]
    return dict(zip(map(int, series.ticks), rows, strict=True))


def _changes(series: Series) -> dict[int, dict[str, float]]:
    """Policy step -> dynamics that hold from then on."""
    # logs of earlier versions lack the gains
    names = [*(n for n in DYNAMICS if n in series.columns or n not in _GAINS), MEMORY]
    columns = {name: series.numbers(name) for name in names}
    return {
        int(tick): {name: float(column[i]) for name, column in columns.items()}
        for i, tick in enumerate(series.ticks)
    }
