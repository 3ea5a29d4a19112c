"""Replay: simulate a log again, and compare with every logged state."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aslip.base.assets import user_path
from aslip.errors import AslipError, ConfigurationError
from aslip.log.frozen_model import low_level_digest, model_digest
from aslip.log.reader import Recording, read
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
    compared: int
    """Number of logged states with which the simulation was compared."""
    diverged_at: float | None
    """Log time of the first state that differs in a bit [s]; None if all are equal."""
    largest_difference: float
    """Largest difference of the configuration in these states [m, rad]."""
    doubts: tuple[str, ...]
    """Reasons why the simulation may differ: other versions, or another model."""

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
    # imported here, because it takes a second, which `info` saves
    from aslip.log.replayed_robot import ReplayedRobot

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
    """Reasons why a simulation may not be bit-equal."""
    doubts, metadata = [], recording.metadata
    made, here = metadata.get("version/mujoco"), importlib.metadata.version("mujoco")
    if made != here:
        doubts.append(
            f"the log was made with MuJoCo {made or '(unknown)'}, this is {here}; for an exact"
            f" replay: pip install mujoco=={made}"
        )
    if model_digest(robot.model) != metadata.get("model_digest"):
        doubts.append(
            "the model compiles differently here than where the log was made"
            f" ({metadata.get('platform')})"
        )
    if low_level_digest() != metadata.get("low_level_digest"):
        doubts.append(
            "the log was made with other code of the drive, the sensors or the robot: aslip"
            f" {metadata.get('version/aslip')}"
        )
    return tuple(doubts)
