"""Pool of simulations in parts; one thread steps a part through a whole policy period.

A single `mujoco.batch` on several threads synchronises them 60 times per policy step and runs the
drive on one thread. Parts need no synchronisation: the drive of one runs while MuJoCo steps
another. The states of a part fit into a core's cache. Results equal those of a single
`Simulations`, bit for bit.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait

import mujoco
import numpy as np

from aslip.base.checks import check_count, check_ids, check_states
from aslip.base.processes import processors
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import load_model
from aslip.sim.drive import PD, MakeDrive
from aslip.sim.simulations import Simulations
from aslip.sim.truth import Snapshot

# larger parts exceed the cache, smaller parts cost more Python
_LARGEST_PART = 64


class SimulationPool:
    """Pool of `num` simulations with the interface of `Simulations`.

    Args:
        num: number of simulations.
        model: compiled model; by default the robot's, without visual geoms.
        num_threads: physics threads, 0 for all processors of this process.
        robot: robot of the model.
        drive: low level between commands and motors.

    Raises:
        ConfigurationError: `num` or `num_threads` is not a count.
    """

    def __init__(
        self,
        num: int,
        *,
        model: mujoco.MjModel | None = None,
        num_threads: int = 0,
        robot: Robot = CASSIE,
        drive: MakeDrive = PD,
    ) -> None:
        self.num = num = check_count("the number of simulations", num)
        num_threads = check_count("num_threads", num_threads, least=0)
        self.model = load_model(visual=False, robot=robot) if model is None else model
        self.indices = robot.indices
        threads = num_threads or processors()
        # parts of equal size, the same number for each thread
        rounds = math.ceil(num / (threads * _LARGEST_PART))
        size = math.ceil(num / (threads * rounds))
        self._starts = np.arange(0, num, size)
        self.parts = [
            Simulations(
                min(size, num - int(start)),
                model=self.model,
                num_threads=1,
                robot=robot,
                drive=drive,
            )
            for start in self._starts
        ]
        self._threads = min(threads, len(self.parts))
        self._executor = ThreadPoolExecutor(self._threads)
        # id of the process that owns the threads, set in the first period; forks have no threads
        self._process: int | None = None
        self._watched_part = 0

    @property
    def command_size(self) -> int:
        """Size of a robot's command; see `Drive.command_size`."""
        return self.parts[0].command_size

    @property
    def divergences(self) -> int:
        """Number of simulations that diverged and were reset since construction."""
        return sum(part.divergences for part in self.parts)

    def reset(
        self, ids: np.ndarray, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None
    ) -> None:
        """Restart some simulations; see `Simulations.reset`.

        Args:
            ids: (k,) simulations, sorted and unique.
            qpos: (k, 35) initial positions, the standing keyframe by default.
            qvel: (k, 32) initial velocities, rest by default.

        Raises:
            ConfigurationError: a simulation does not exist, or this process was forked; nothing is
                reset.
            ShapeError: an array has the wrong shape; nothing is reset.
        """
        self._check_process()
        ids = check_ids(ids, self.num)
        _check_shapes(
            {"qpos": (qpos, (len(ids), self.model.nq)), "qvel": (qvel, (len(ids), self.model.nv))}
        )
        for part, rows, own_ids in self._owners(ids):
            initial = (None if value is None else value[rows] for value in (qpos, qvel))
            part.reset(own_ids, *initial)

    def write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Change fields of some simulations' models; see `Simulations.write_fields`."""
        ids = check_ids(ids, self.num)
        for part, rows, own_ids in self._owners(ids):
            part.write_fields(own_ids, {name: values[rows] for name, values in fields.items()})

    def _owners(self, ids: np.ndarray) -> Iterator[tuple[Simulations, np.ndarray, np.ndarray]]:
        """Parts of some simulations, with the rows in `ids` and the ids within the part."""
        owner = np.searchsorted(self._starts, ids, side="right") - 1
        for i in np.unique(owner):
            rows = owner == i
            yield self.parts[i], rows, ids[rows] - self._starts[i]

    def watch(self, index: int | None) -> None:
        """Record every substep of one simulation in `watched` from now on; None stops it.

        Raises:
            ConfigurationError: the simulation does not exist, or the timestep is not a substep.
        """
        if index is not None and not 0 <= index < self.num:
            raise ConfigurationError(f"simulation must be from 0 to {self.num - 1}, got {index!r}")
        owner = 0 if index is None else int(np.searchsorted(self._starts, index, side="right")) - 1
        for i, part in enumerate(self.parts):
            part.watch(None if index is None or i != owner else index - int(self._starts[i]))
        self._watched_part = owner

    @property
    def watched(self) -> np.ndarray:
        """(60, 83) substeps of the watched simulation; see `Simulations.watched`."""
        return self.parts[self._watched_part].watched

    def advance(self, motor_target: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Run one policy period; see `Simulations.advance`.

        Errors of a part and Ctrl-C are raised after all threads have finished, so that no thread
        still changes the states.

        Args:
            motor_target: (n, `command_size`) commands of the drive, joint angles for `PD` [rad].
            push: (n, 3) forces on the pelvis' origin during the period [N, world]; zero by default.

        Returns:
            (n,) bool, True for simulations that diverged and were reset to standing.

        Raises:
            ConfigurationError: this process was forked after the first step.
            ShapeError: `motor_target` or `push` has the wrong shape; no part is stepped.
        """
        self._check_process()
        _check_shapes(
            {
                "motor_target": (motor_target, (self.num, self.command_size)),
                "push": (push, (self.num, 3)),
            }
        )
        shares = np.split(motor_target, self._starts[1:])
        pushes = [None] * len(shares) if push is None else np.split(push, self._starts[1:])
        self._process = os.getpid()
        try:
            jobs = [
                self._executor.submit(part.advance, share, force)
                for part, share, force in zip(self.parts, shares, pushes, strict=True)
            ]
            wait(jobs)
        except BaseException:
            self._come_to_rest()
            raise
        return np.concatenate([job.result() for job in jobs])

    def _check_process(self) -> None:
        """Refuse a forked process, in which jobs would wait forever for missing threads.

        Raises:
            ConfigurationError: another process has stepped the simulations.
        """
        if self._process not in (None, os.getpid()):
            raise ConfigurationError(
                f"process {self._process} has stepped these simulations, and its fork {os.getpid()}"
                " lacks their threads; make the environment in the process that steps it, or start"
                ' processes with the method "spawn"'
            )

    def _come_to_rest(self) -> None:
        """Let the threads finish all jobs, then replace them by new ones.

        After an interrupt, the list of jobs may lack the last one, but the executor knows it.
        """
        resting = False
        while not resting:
            with contextlib.suppress(KeyboardInterrupt):
                self._executor.shutdown(wait=True)
                resting = True
        self._executor = ThreadPoolExecutor(self._threads)

    def snapshot(self) -> Snapshot:
        """Copies of the arrays of the true state."""
        return Snapshot.concatenate([part.snapshot() for part in self.parts])

    def packets(self) -> dict[str, np.ndarray]:
        """Copies of the sensors' packets of the last policy period; see `Sensors.packets`."""
        parts = [part.sensors.packets() for part in self.parts]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def states(self) -> np.ndarray:
        """(n, k) copy of the complete states; see `Simulations.states`."""
        return np.concatenate([part.states() for part in self.parts])

    def set_states(self, states: np.ndarray) -> None:
        """Restore a result of `states`, from these or other simulations of the same model.

        Raises:
            ShapeError: the states have another number or model; nothing is changed.
        """
        states = check_states(states, (self.num, self.parts[0].state_size))
        for part, rows in zip(self.parts, np.split(states, self._starts[1:]), strict=True):
            part.set_states(rows)


def _check_shapes(arrays: Mapping[str, tuple[np.ndarray | None, tuple[int, ...]]]) -> None:
    """Check arrays of all simulations before any part takes its share.

    Raises:
        ShapeError: an array is given and has another shape.
    """
    for name, (array, shape) in arrays.items():
        if array is not None and array.shape != shape:
            raise ShapeError(f"{name} must have shape {shape}, got {array.shape}")
