"""Simulations in parts, each stepped through a policy period by one thread.

One `mujoco.batch` stepped on several threads must wait for all of them 60 times a policy step, and
meanwhile runs the drive on one. Parts never wait for each other, and one part's drive runs while
MuJoCo steps another. Parts are small enough for their states to stay in a core's cache. Results
equal those of a single `Simulations`, bit for bit.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait

import mujoco
import numpy as np

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import load_model
from aslip.sim.checks import check_count, check_ids, check_states
from aslip.sim.drive import PD, MakeDrive
from aslip.sim.simulations import Simulations
from aslip.sim.truth import Snapshot

# larger parts fall out of the cache, smaller ones cost more Python
_LARGEST_PART = 64


class SimulationPool:
    """Num simulations; the same questions and answers as `Simulations`.

    Args:
        num: number of simulations.
        model: compiled model; by default the robot without what is only looked at.
        num_threads: threads to step on, 0 for all processors this process may use.
        robot: robot that the model is of.
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
        # equal parts, as many for each thread
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
        # threads come with the first period, and do not follow into a forked process
        self._process: int | None = None
        self._watched_part = 0

    @property
    def command_size(self) -> int:
        """Numbers in the command of a simulation's drive."""
        return self.parts[0].command_size

    @property
    def divergences(self) -> int:
        """Simulations put back on their feet since construction."""
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
            ConfigurationError: there is no such simulation, or this is a forked process; nothing
                has been reset then.
            ShapeError: an array does not fit; nothing has been reset then.
        """
        self._check_process()
        ids = check_ids(ids, self.num)
        for name, value, size in (("qpos", qpos, self.model.nq), ("qvel", qvel, self.model.nv)):
            if value is not None and value.shape != (len(ids), size):
                raise ShapeError(f"{name} must have shape {(len(ids), size)}, got {value.shape}")
        for part, rows, own_ids in self._owners(ids):
            initial = (None if value is None else value[rows] for value in (qpos, qvel))
            part.reset(own_ids, *initial)

    def write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Change fields of some simulations' models; see `Simulations.write_fields`."""
        ids = check_ids(ids, self.num)
        for part, rows, own_ids in self._owners(ids):
            part.write_fields(own_ids, {name: values[rows] for name, values in fields.items()})

    def _owners(self, ids: np.ndarray) -> Iterator[tuple[Simulations, np.ndarray, np.ndarray]]:
        """Parts that have some of these simulations: which of them, and their ids there."""
        owner = np.searchsorted(self._starts, ids, side="right") - 1
        for i in np.unique(owner):
            rows = owner == i
            yield self.parts[i], rows, ids[rows] - self._starts[i]

    def watch(self, index: int | None) -> None:
        """Keep every substep of one simulation in `watched` from now on; None for none.

        Raises:
            ConfigurationError: there is no such simulation, or the physics does not step as often.
        """
        if index is not None and not 0 <= index < self.num:
            raise ConfigurationError(f"no simulation {index!r}; there are {self.num}, from 0")
        owner = 0 if index is None else int(np.searchsorted(self._starts, index, side="right")) - 1
        for i, part in enumerate(self.parts):
            part.watch(None if index is None or i != owner else index - int(self._starts[i]))
        self._watched_part = owner

    @property
    def watched(self) -> np.ndarray:
        """(60, 83) every substep of the watched simulation; see `Simulations.watched`."""
        return self.parts[self._watched_part].watched

    def advance(self, motor_target: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Run one policy period; see `Simulations.advance`.

        Also when a part fails, or at Ctrl-C, nothing is raised before all threads have come to
        rest, so that whoever catches it reads states that no longer change.

        Args:
            motor_target: (n, m) commands of the drive: joint angles that PD loops track [rad].
            push: (n, 3) forces on the pelvis' origin throughout the period [N, world]; none by
                default.

        Returns:
            (n,) bool, the simulations that diverged and stand at the keyframe now.

        Raises:
            ConfigurationError: this process was forked after the simulations had been stepped.
            ShapeError: the targets do not fit.
        """
        self._check_process()
        if motor_target.shape != (self.num, self.command_size):
            expected = (self.num, self.command_size)
            raise ShapeError(f"motor_target must have shape {expected}, got {motor_target.shape}")
        if push is not None and push.shape != (self.num, 3):
            raise ShapeError(f"push must have shape {(self.num, 3)}, got {push.shape}")
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
        """Refuse a forked process, in which jobs would wait for threads that are not there.

        Raises:
            ConfigurationError: the simulations have been stepped in another process.
        """
        if self._process not in (None, os.getpid()):
            raise ConfigurationError(
                f"these simulations were stepped in process {self._process}, from which this one"
                f" ({os.getpid()}) was forked without their threads; make the environment in the"
                ' process that steps it, or start processes with the method "spawn"'
            )

    def _come_to_rest(self) -> None:
        """Let the threads finish what they were given, and replace them by new ones.

        To wait for the jobs would not do: an interrupt may come before the last is in the list.
        """
        resting = False
        while not resting:
            with contextlib.suppress(KeyboardInterrupt):
                self._executor.shutdown(wait=True)
                resting = True
        self._executor = ThreadPoolExecutor(self._threads)

    def snapshot(self) -> Snapshot:
        """Copies of everything the true state is made of."""
        return Snapshot.concatenate([part.snapshot() for part in self.parts])

    def packets(self) -> dict[str, np.ndarray]:
        """Copies of the sensors' packets of the last policy period; see `Sensors.packets`."""
        parts = [part.sensors.packets() for part in self.parts]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def states(self) -> np.ndarray:
        """(n, k) copy of all that the future depends on; see `Simulations.states`."""
        return np.concatenate([part.states() for part in self.parts])

    def set_states(self, states: np.ndarray) -> None:
        """Write what `states` returned, into these or other simulations of the same model.

        Raises:
            ShapeError: the states are of another number or model; nothing has been written then.
        """
        states = check_states(states, (self.num, self.parts[0].state_size))
        for part, rows in zip(self.parts, np.split(states, self._starts[1:]), strict=True):
            part.set_states(rows)


def processors() -> int:
    """Processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
