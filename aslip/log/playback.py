"""Replay: simulate a log from the file alone, and compare with every logged state."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.log.frozen_model import low_level_digest, model_digest
from aslip.log.reader import Recording, Series, read
from aslip.robot import CASSIE

if TYPE_CHECKING:
    from aslip.log.replayed_robot import ReplayedRobot

TOPICS = ("/step", "/state", "/dynamics")
"""Topics that a replay reads."""


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    start: float
    """Log time of the first state [s]."""
    steps: int
    """Policy steps that were simulated."""
    state_time: np.ndarray
    """(k,) log time of each compared state [s]."""
    drift: np.ndarray
    """(k,) largest difference of each compared state; 0 if bit-equal."""
    qpos_drift: np.ndarray
    """(k,) largest difference of the configuration `qpos` alone [m, rad]."""
    doubts: tuple[str, ...]
    """Reasons why the simulation may differ: other versions, or another model."""
    time: np.ndarray = field(repr=False)
    """(m,) log time of each step's end [s]."""
    qpos: np.ndarray = field(repr=False)
    """(m, nq) configurations."""
    qvel: np.ndarray = field(repr=False)
    """(m, nv) velocities."""

    @property
    def compared(self) -> int:
        """Number of compared states."""
        return len(self.state_time)

    @property
    def equal(self) -> bool:
        """True if every compared state is bit-equal."""
        return self.diverged_at is None

    @property
    def diverged_at(self) -> float | None:
        """Log time of the first state that differs [s]; None if all are bit-equal."""
        differ = np.flatnonzero(self.drift)
        return float(self.state_time[differ[0]]) if len(differ) else None

    @property
    def largest_difference(self) -> float:
        """Largest difference of any number of any state."""
        return float(self.drift.max(initial=0.0))


def replay(log: str | Path | Recording, start: float = 0.0, *, strict: bool = True) -> Replay:
    """Simulate a log again with its motor targets and pushes.

    Every episode starts from a logged state, and so does the part after a gap of a recovered log.

    Args:
        log: a recording, or the path of a log.
        start: time [s]; the replay starts from the last logged state at or before it.
        strict: refuse a replay that cannot be bit-equal, and stop at the first difference.
            Otherwise compare all states; `Replay.doubts` has reasons for differences.

    Raises:
        FileDamagedError: the log is damaged, or has no states or steps.
        ConfigurationError: a strict replay cannot be bit-equal, because the log was made with
            another version of MuJoCo or its model compiles differently here; or the log has no
            state at or before `start`, or no policy step after that state.
    """
    recording = log if isinstance(log, Recording) else read(log, TOPICS)
    try:
        return _replayed(recording, start, strict)
    except AslipError as error:
        raise type(error)(f"cannot replay {str(recording.path)!r}: {error}") from error


def _replayed(recording: Recording, start: float, strict: bool) -> Replay:
    # imported here, because it takes a second, which `info` saves
    from aslip.log.replayed_robot import ReplayedRobot

    robot = ReplayedRobot(recording)
    doubts = _doubts(recording, robot)
    if strict and doubts:
        raise ConfigurationError(
            f"{doubts[0]}; measure the drift of the simulation with replay(strict=False), or"
            " python -m aslip.log replay --drift"
        )
    run = _Run(recording, robot, start)
    for _ in run.steps():
        if strict and run.drift and run.drift[-1] > 0:
            break
    return run.result(doubts)


class _Run:
    """Replay from one state of a log."""

    def __init__(self, recording: Recording, robot: ReplayedRobot, start: float) -> None:
        self._robot, self._start = robot, start
        states, steps = (_series(recording, topic) for topic in ("/state", "/step"))
        self._rows = robot.rows(states)
        self._ticks = _ticks(steps)
        self._targets = np.stack(
            [_column(steps, f"motor_target_{n}") for n in CASSIE.motor_names], axis=1
        )
        self._pushes = np.stack([_column(steps, f"push_{axis}") for axis in "xyz"], axis=1)
        before = np.flatnonzero(states.time <= start + 1e-9)
        if len(before) == 0:
            raise ConfigurationError(
                f"the log begins at {states.time[0]:g} s; it has no state at {start:g} s"
            )
        self._known = {int(tick): i for i, tick in enumerate(_ticks(states)) if i >= before[-1]}
        self._first = int(_ticks(states)[before[-1]])
        self._path: list[tuple[int, np.ndarray, np.ndarray]] = []
        self._compared: list[tuple[int, float]] = []
        self.drift: list[float] = []

    def steps(self) -> Iterator[None]:
        """Simulate policy step by policy step."""
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
            self._path.append((tick, robot.qpos, robot.qvel))
            if tick in self._known:
                self._compare(tick)
            yield

    def _compare(self, tick: int) -> None:
        """Compare the present state with the logged one."""
        row = self._rows[self._known[tick]]
        state = self._robot.state(row)
        difference = _difference(state, row)
        nq = len(self._path[-1][1])
        # `time` comes first in the state, then `qpos`
        self._compared.append((tick, _difference(state[1 : 1 + nq], row[1 : 1 + nq])))
        self.drift.append(difference)

    def result(self, doubts: tuple[str, ...]) -> Replay:
        """Result of the replay.

        Raises:
            ConfigurationError: no step was simulated.
        """
        if not self._path:
            raise ConfigurationError(
                f"no policy step follows the state at {self._first * CASSIE.policy_period:g} s, the"
                f" last one before {self._start:g} s"
            )
        return Replay(
            start=self._first * CASSIE.policy_period,
            steps=len(self._path),
            state_time=np.array([tick * CASSIE.policy_period for tick, _ in self._compared]),
            drift=np.array(self.drift),
            qpos_drift=np.array([drift for _, drift in self._compared]),
            doubts=doubts,
            time=np.array([tick * CASSIE.policy_period for tick, _, _ in self._path]),
            qpos=np.array([qpos for _, qpos, _ in self._path]),
            qvel=np.array([qvel for _, _, qvel in self._path]),
        )


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of two arrays; the smallest normal number if only bits differ."""
    if one.tobytes() == other.tobytes():
        return 0.0
    return max(float(np.max(np.abs(one - other))), float(np.finfo(float).tiny))


def low_level_differs(recording: Recording) -> bool:
    """True if drive, sensors or constants of this package have changed since the log was made."""
    return recording.metadata.get("low_level_digest") != low_level_digest()


def _doubts(recording: Recording, robot: ReplayedRobot) -> tuple[str, ...]:
    """Reasons why a simulation cannot be bit-equal."""
    doubts, metadata = [], recording.metadata
    made, here = metadata.get("version/mujoco"), importlib.metadata.version("mujoco")
    if made != here:
        doubts.append(
            f"the log was made with MuJoCo {made or '(unknown)'}, this is {here}; for an exact"
            f" replay: pip install mujoco=={made}"
        )
    if model_digest(robot.model) != metadata.get("model_digest"):
        doubts.append(
            "the model of the log compiles differently here than where the log was made"
            f" ({metadata.get('platform')})"
        )
    return tuple(doubts)


def _series(recording: Recording, topic: str) -> Series:
    if topic not in recording.series:
        raise FileDamagedError(f"the log has no topic {topic}")
    return recording[topic]


def _ticks(series: Series) -> np.ndarray:
    """Policy steps since the log began (m,); times of a log are multiples of the period."""
    return np.rint(series.time / CASSIE.policy_period).astype(int)


def _column(series: Series, name: str) -> np.ndarray:
    """Column (m,) of numbers.

    Raises:
        FileDamagedError: the column has other values.
    """
    column = series[name]
    if column.dtype.kind != "f" or column.ndim != 1:
        raise FileDamagedError(f"{series.topic} must have one number per message as {name!r}")
    return column
