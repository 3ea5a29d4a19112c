"""Simulate a log again, from the file alone, and compare every state it has."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from aslip.cassie import MOTOR_NAMES, POLICY_PERIOD
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log.frozen_model import low_level_digest, model_digest, thaw_model
from aslip.log.reader import Recording, Series, read


@dataclass(frozen=True)
class Replay:
    """What a replay has come to."""

    start: float
    """Log time of the state it began from [s]."""
    steps: int
    """Policy steps that were simulated."""
    compared: int
    """States of the log that were compared."""
    diverged_at: float | None
    """Log time of the first state that differed [s]; None if all were equal, bit for bit."""
    largest_difference: float
    """Of that state's numbers."""
    time: np.ndarray = field(repr=False)
    """(m,) log time of each step's end [s]."""
    qpos: np.ndarray = field(repr=False)
    """(m, 35) configurations."""
    qvel: np.ndarray = field(repr=False)
    """(m, 32) velocities."""

    @property
    def equal(self) -> bool:
        """Whether the replay is the log's simulation, bit for bit."""
        return self.diverged_at is None


def replay(log: str | Path | Recording, start: float = 0.0) -> Replay:
    """Run the simulation of a log again with its motor targets and pushes.

    Args:
        log: the log, or its path.
        start: begin from the last state that the log has at or before this time [s].

    Raises:
        FileDamagedError: the log is damaged, or has no states or steps.
        ConfigurationError: it was made by another version of MuJoCo, or its model compiles to
            something else here, so that nothing could be said about its simulation; or it has no
            state at or before `start`, or no policy step after that.
    """
    recording = log if isinstance(log, Recording) else read(log, ["/step", "/state"])
    model = _same_model(recording)
    states, steps = (_series(recording, topic) for topic in ("/state", "/step"))
    targets = np.stack([steps[f"motor_target_{name}"] for name in MOTOR_NAMES], axis=1)
    pushes = steps.vector("push")
    # times of the log are whole policy steps
    state_ticks, step_ticks = (
        np.rint(series.time / POLICY_PERIOD).astype(int) for series in (states, steps)
    )
    before = np.flatnonzero(states.time <= start + 1e-9)
    if len(before) == 0:
        raise ConfigurationError(
            f"the log begins at {states.time[0]:g} s, there is no state at {start:g} s"
        )
    rows = np.concatenate([states["integration"], states["sensors"]], axis=1)
    first = int(before[-1])
    known = {int(state_ticks[i]): i for i in range(first, len(states))}
    from aslip.sim import Simulations  # takes a second, which `info` and `check` need not

    simulations = Simulations(1, model=model, num_threads=1)
    simulations.set_states(rows[first : first + 1])
    path, compared = [], 0
    for i in np.flatnonzero(step_ticks > state_ticks[first]):
        tick = int(step_ticks[i])
        begins = known.get(tick - 1)
        if begins is not None and states["step"][begins] == 0:
            simulations.set_states(rows[begins : begins + 1])
        simulations.advance(targets[i : i + 1], pushes[i : i + 1])
        path.append((tick, simulations.qpos[0].copy(), simulations.qvel[0].copy()))
        row = known.get(tick)
        if row is None:
            continue
        compared += 1
        state = simulations.states()[0]
        if state.tobytes() != rows[row].tobytes():
            difference = float(np.nanmax(np.abs(state - rows[row])))
            return _result(states, first, path, compared, (tick, difference))
    if not path:
        raise ConfigurationError(
            f"nothing follows the state at {states.time[first]:g} s, the last of the log before"
            f" {start:g} s"
        )
    return _result(states, first, path, compared, None)


def _result(
    states: Series,
    first: int,
    path: list[tuple[int, np.ndarray, np.ndarray]],
    compared: int,
    difference: tuple[int, float] | None,
) -> Replay:
    return Replay(
        start=float(states.time[first]),
        steps=len(path),
        compared=compared,
        diverged_at=None if difference is None else difference[0] * POLICY_PERIOD,
        largest_difference=0.0 if difference is None else difference[1],
        time=np.array([tick * POLICY_PERIOD for tick, _, _ in path]),
        qpos=np.array([qpos for _, qpos, _ in path]),
        qvel=np.array([qvel for _, _, qvel in path]),
    )


def low_level_differs(recording: Recording) -> bool:
    """Whether drive, sensors or constants of this package have changed since the log was made."""
    return recording.metadata.get("low_level_digest") != low_level_digest()


def _same_model(recording: Recording) -> mujoco.MjModel:
    """The log's model.

    Raises:
        ConfigurationError: it would not be the same here.
    """
    made, here = (
        recording.metadata.get("version/mujoco"),
        importlib.metadata.version("mujoco"),
    )
    if made != here:
        raise ConfigurationError(
            f"the log was made with MuJoCo {made}, this is {here}; its simulation can only be"
            f" repeated with: pip install mujoco=={made}"
        )
    model = thaw_model(recording.attachments)
    if model_digest(model) != recording.metadata.get("model_digest"):
        raise ConfigurationError(
            "the model in the log compiles to another one here than where the log was made"
            f" ({recording.metadata.get('platform')}); its simulation cannot be repeated"
        )
    return model


def _series(recording: Recording, topic: str) -> Series:
    if topic not in recording.series:
        raise FileDamagedError(f"{str(recording.path)!r} has no {topic}: nothing to replay")
    return recording[topic]
