"""Simulation of a logged robot, with the dynamics and states of the log."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log.frozen_model import LONGEST_MEMORY, is_known, thaw_model
from aslip.log.messages import MEMORY
from aslip.log.reader import Recording, Series
from aslip.robot import CASSIE
from aslip.sim import DYNAMICS, Dynamics, Simulations
from aslip.sim.dynamics import with_memory_of

_ONE = np.zeros(1, dtype=int)
# parameters that logs of earlier versions lack
_GAINS = ("pd_stiffness", "pd_damping")


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
        self._simulations = Simulations(1, model=self.model, num_threads=1)
        self._size = self._simulations.states().shape[1]

    def rows(self, states: Series) -> list[np.ndarray]:
        """States of `/state`, as `set_state` takes them."""
        pairs = zip(states["integration"], states["sensors"], strict=True)
        return [np.concatenate([np.ravel(part) for part in pair]) for pair in pairs]

    def change(self, tick: int) -> None:
        """Set the last dynamics that were logged at or before an instant.

        Raises:
            FileDamagedError: dynamics are missing or out of range.
        """
        past = [at for at in self._changes if at <= tick]
        if not past:
            raise FileDamagedError(
                f"/dynamics does not begin before {tick * CASSIE.policy_period:g} s"
            )
        values = dict(self._changes[max(past)])
        self._lengthen(self._checked_memory(values.pop(MEMORY)))
        try:
            fields = self._dynamics.update(_ONE, values)
        except ValueError as error:
            raise FileDamagedError(
                f"/dynamics at {tick * CASSIE.policy_period:g} s: {error}"
            ) from error
        self._simulations.write_fields(_ONE, fields)

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
        self._simulations.set_states(states)
        self._memory = memory

    def _converted(self, states: np.ndarray, memory: int, to: int) -> np.ndarray:
        """Convert states to a memory of `to` commands."""
        if memory == to:
            return states
        models = (self._thaw(number) for number in (memory, to))
        return with_memory_of(states, *models)


def _changes(series: Series) -> dict[int, dict[str, float]]:
    """Policy step -> dynamics that hold from then on."""
    # logs of earlier versions lack the gains
    names = [*(n for n in DYNAMICS if n in series.columns or n not in _GAINS), MEMORY]
    columns = {name: series.numbers(name) for name in names}
    return {
        int(tick): {name: float(column[i]) for name, column in columns.items()}
        for i, tick in enumerate(series.ticks)
    }
