"""Simulated robots: base class of both simulators.

Keys in addition to those of `RobotEnv`, for n robots, with shapes that omit the leading n:

| key | shape | meaning |
|---|---|---|
| `push` | 3 | optional input: force on the pelvis during this policy step [N, world] |
| `("truth", ...)` | | see `aslip.sim.true_state`; `qpos` and `qvel` are doubles |
| `("truth", "diverged")` | 1 | the simulation diverged in this policy step; the robot stands now |
| `("truth", "slope")` | 1 | rise of the floor along the world's x [rad], see `aslip.sim.DYNAMICS` |
| `("truth", "ground_height")` | 1 | height of the stones below the loaded feet [m, world] |
| `terminated`, `done` | 1 | the simulation diverged |

A reset request may have the initial state, `("initial", "qpos")` (35) and `("initial", "qvel")`
(32); by default the robot stands, or starts where the stack's `ReferenceStart` puts it. It may also
have parameters of `aslip.sim.DYNAMICS`, `("dynamics", name)` (1); other parameters keep their
values, or are drawn by the stack's `RandomDynamics`. Stones, `("course", "stones")` (s, 6), have
the columns of `aslip.sim.course.STONE`, and are NaN where is none; by default they stay. These
entries are not in `state_spec`, because TorchRL would require them in every step; so TorchRL's
wrappers, such as `SerialEnv`, drop them.

A NaN target makes only its own simulation diverge. TorchRL copies `push` from step to step: remove
it when the push ends.

Further methods: `dynamics`, `weight` and `set_dynamics` for the dynamics; `stones`, `set_course`
and `set_stones` for the ground; `states`, `set_states` and `watch` for logs and replay.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import mujoco
import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, TensorSpec, Unbounded

from aslip.base.arrays import Array, is_numpy, namespace
from aslip.base.checks import check_ids
from aslip.base.decorators import on_cpu_in_single
from aslip.envs.robot_env import RobotEnv, check_entry
from aslip.errors import ShapeError, UnknownNameError
from aslip.robot import CASSIE, SIDES, Robot
from aslip.sim import PD, Dynamics, MakeDrive, Snapshot, true_state
from aslip.sim.course import Course, ground_height
from aslip.sim.dynamics import load_again, longest_delay, with_memory_of
from aslip.sim.stones import PlacedStones

# kept in double precision, for logs and replay
_DOUBLE = ("qpos", "qvel")
# places of `aslip.robot.Indices` that select columns
_COLUMNS = ("motor_qpos", "motor_qvel", "joint_qpos", "joint_qvel", "foot_velocity")


class SimulatedEnv(RobotEnv):
    """N simulated robots that track motor targets; the module lists the keys.

    Args:
        num_envs: number of robots.
        robot: robot model, `CASSIE` by default.
        command_size: size of a robot's `motor_target`; the number of motors by default.
        drive: low level that takes `motor_target`.
    """

    def __init__(
        self,
        num_envs: int,
        robot: Robot = CASSIE,
        command_size: int | None = None,
        drive: MakeDrive = PD,
    ) -> None:
        self._places = replace(
            robot.indices,
            **{name: self._arranged(getattr(robot.indices, name)) for name in _COLUMNS},
        )
        self.make_drive = drive
        """Low level that takes `motor_target`."""
        self.indices = robot.indices
        self.divergences: int | Array = 0
        """Number of simulations that diverged and were reset since construction."""
        self._dynamics = Dynamics(num_envs, self.model, robot, self._arranged)
        self._stones = PlacedStones(num_envs, self.model, self._arranged)
        self.altered = False
        """True once a robot has had other dynamics than `model`."""
        super().__init__(num_envs, robot, command_size)

    # --------------------------------------------- methods of a simulator

    @abstractmethod
    def _advance(self, motor_target: Array, push: Array | None) -> Array:
        """Run one policy period; return (n,) bool, True where a simulation diverged.

        Args:
            motor_target: (n, 10) [rad].
            push: (n, 3) forces on the pelvis [N, world], or None.
        """

    @abstractmethod
    def _restart(self, ids: Array, qpos: Array | None, qvel: Array | None) -> None:
        """Restart (k,) simulations at `qpos` (k, 35) and `qvel` (k, 32), by default standing."""

    @abstractmethod
    def _snapshot(self) -> Snapshot:
        """MuJoCo's arrays of all simulations, leading shape (n,)."""

    @abstractmethod
    def _write_fields(self, ids: Array, fields: Mapping[str, Array]) -> None:
        """Change fields (k, ...) of the models of (k,) robots."""

    @abstractmethod
    def _use_model(self, model: mujoco.MjModel) -> None:
        """Replace `model` by one with a longer memory of commands or other stones.

        Simulations are standing afterwards, with the model's own fields.
        """

    @property
    @abstractmethod
    def model(self) -> mujoco.MjModel:
        """Model of the robots, without changes by `set_dynamics`."""

    @abstractmethod
    def states(self) -> np.ndarray:
        """(n, k) copy of the complete states of the simulations, between policy steps.

        A row is `mjSTATE_INTEGRATION` followed by the memory of the sensors, in both simulators.
        States of transforms are in the tensordict.
        """

    @abstractmethod
    def set_states(self, states: np.ndarray) -> None:
        """Restore a result of `states`, from this or another environment with the same model.

        Raises:
            ShapeError: the states have another number of robots or another model; nothing is
                changed.
        """

    @abstractmethod
    def watch(self, index: int | None) -> None:
        """Record every substep of one robot in `watched` from now on; None stops it.

        Raises:
            ConfigurationError: the robot does not exist.
        """

    @property
    @abstractmethod
    def watched(self) -> np.ndarray:
        """(60, 83) substeps of the watched robot's last policy step; see `Simulations.watched`."""

    _visual = False
    """Whether `model` has visual geoms."""

    # for simulators whose arrays are not NumPy's

    def _arranged(self, values: np.ndarray) -> Array:
        """Array of the simulator's kind."""
        return values

    def _checked_ids(self, ids: Any) -> Array:
        """(k,) robots that exist, sorted and unique."""
        return check_ids(ids, self.num_envs)

    # --------------------------------------------------------------- dynamics

    @property
    def dynamics(self) -> dict[str, np.ndarray]:
        """(n,) copies of each parameter's values, by the names of `aslip.sim.DYNAMICS`."""
        return {name: _on_host(values) for name, values in self._dynamics.values.items()}

    @property
    def weight(self) -> np.ndarray:
        """(n,) weight of each robot normal to the floor [N], with mass, payload and slope."""
        fields = self._dynamics.fields(self._everyone, ("mass", "payload", "slope"))
        return -_on_host(fields["body_mass"]).sum(axis=1) * _on_host(fields["opt.gravity"])[:, 2]

    def set_dynamics(self, values: Mapping[str, ArrayLike], ids: np.ndarray | None = None) -> None:
        """Change the dynamics of robots from the next physics step on, also after resets.

        `states` does not contain them. For a torque delay above 4 ms the model needs a longer
        memory of commands: all simulations move to such a model, and `states` grow.

        Args:
            values: parameter of `aslip.sim.DYNAMICS` -> one value, or one per robot.
            ids: (k,) robots, sorted and unique; all by default.

        Raises:
            UnknownNameError: a parameter does not exist.
            ShapeError: the number of values is neither one nor k.
            ConfigurationError: a robot does not exist or a value is outside its limits; all
                dynamics stay as they are.
        """
        robots = self._everyone if ids is None else self._checked_ids(ids)
        fields = self._dynamics.update(robots, values)
        if not fields:
            return
        self.altered = True
        delay = float(fields["actuator_delay"].max()) if "actuator_delay" in fields else 0.0
        if delay > longest_delay(self.model):
            self._load_again(delay)
        else:
            self._write_fields(robots, fields)

    def _load_again(self, delay: float = 0.0) -> None:
        """Move all simulations to a model that allows a torque delay and has all stones."""
        everyone, model, states = self._everyone, self.model, self.states()
        stones = {"stones": self._stones.rows.shape[1], "prisms": self._stones.prisms}
        settings = {"visual": self._visual, "robot": self.robot}
        self._use_model(load_again(model, delay=delay, **stones, **settings))
        self._dynamics.use_model(self.model)
        self._stones.use_model(self.model)
        fields = self._dynamics.fields(everyone) if self.altered else {}
        if any(stones.values()):
            fields |= self._stones.fields(everyone)
        self._write_fields(everyone, fields)
        self.set_states(with_memory_of(states, model, self.model))

    @property
    def _everyone(self) -> Array:
        return self._arranged(np.arange(self.num_envs))

    # ----------------------------------------------------------------- ground

    @property
    def stones(self) -> np.ndarray:
        """(n, s, 6) copy of the robots' stones, by the columns of `aslip.sim.course.STONE`.

        NaN where is none; a stone that is not a rectangle has no yaw, length and width.
        """
        return _on_host(self._stones.rows)

    def set_course(
        self, course: Course | Sequence[Course | None] | None, ids: np.ndarray | None = None
    ) -> None:
        """Put stones below robots, in the place of their floor, also after resets.

        Robots stay where they are: reset them to start above a course's origin. `states` does not
        contain courses. For more stones than before, or stones that are not rectangles, all
        simulations move to another model, which takes long with MuJoCo Warp.

        Args:
            course: one course, or one per robot; None is the flat floor.
            ids: (k,) robots, sorted and unique; all by default.

        Raises:
            ShapeError: the number of courses is neither one nor k.
            ConfigurationError: a robot does not exist.
        """
        robots = self._everyone if ids is None else self._checked_ids(ids)
        courses = [*course] if isinstance(course, Sequence) else [course] * len(robots)
        if len(courses) != len(robots):
            raise ShapeError(f"course must be one, or {len(robots)} courses, got {len(courses)}")
        self._stones.place(robots, courses)
        self._write_stones(robots)

    def set_stones(self, stones: np.ndarray) -> None:
        """Put stones (n, s, 6) below all robots, NaN where is none, whether these can walk or not.

        See `set_course`. Robots see them if `("stones", "course")` has them, too.

        Raises:
            ShapeError: the stones have another shape.
            ConfigurationError: a stone has numbers and NaN, or no size.
        """
        self._stones.place_rows(self._everyone, self._arranged(stones))
        self._write_stones(self._everyone)

    def _write_stones(self, robots: Array) -> None:
        if not self._stones.fit:
            self._load_again()
        elif self._stones.rows.shape[1]:
            self._write_fields(robots, self._stones.fields(robots))

    # ---------------------------------------------------------------- EnvBase

    def track(self, motor_target: np.ndarray) -> np.ndarray:
        """Track motor targets without a push; see `RobotEnv.track`."""
        return self._advance(motor_target, None)

    def restart(self, robots: np.ndarray) -> None:
        """Reset robots to standing; see `RobotEnv.restart`."""
        self._restart(robots, None, None)

    def _observation_specs(self) -> dict[str, TensorSpec]:
        none = np.zeros(self.batch_size, dtype=bool)
        truth = {
            key: Binary(shape=value.shape, dtype=torch.bool)
            if value.dtype == torch.bool
            else Unbounded(value.shape, dtype=value.dtype)
            for key, value in self._truth(none).items()
        }
        return {**super()._observation_specs(), "truth": Composite(truth, shape=self.batch_size)}

    @on_cpu_in_single
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        target, push = self._checked_target(tensordict), tensordict.get("push", None)
        if push is not None:
            check_entry("push", push, (*self.batch_size, 3))
            push = self._taken(push)
        diverged = self._advance(target, push)
        self.divergences = self.divergences + diverged.sum()
        return self._result(diverged)

    @on_cpu_in_single
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        del kwargs
        rows = self._robots_to_reset(tensordict)
        initial: list[Array | None] = [None, None]
        if tensordict is not None:
            start = reset_request(tensordict, "initial")
            for name in start.keys() - set(_DOUBLE):
                raise UnknownNameError.among("initial state", name, _DOUBLE)
            for i, name in enumerate(_DOUBLE):
                if name in start:
                    expected = tuple(self.observation_spec["truth", name].shape)
                    check_entry(f"initial {name}", start[name], expected)
                    initial[i] = self._taken(start[name])[rows]
            self.set_dynamics(self._requested_dynamics(tensordict, rows), rows)
            self._place_requested(reset_request(tensordict, "course"), rows)
        self._restart(rows, *initial)
        return self._start()

    def _place_requested(self, course: Mapping[str, Tensor], rows: Array) -> None:
        """Place the stones of a reset request; see `PlacedStones.place_rows`."""
        for name in course:
            if name != "stones":
                raise UnknownNameError.among("entry of a course", name, ["stones"])
            stones = self._taken(course[name])
            self._stones.place_rows(rows, stones[rows])
            self._write_stones(rows)

    def _requested_dynamics(self, tensordict: TensorDictBase, rows: Array) -> dict[str, Array]:
        """Parameter -> values (k,) of a reset request.

        Raises:
            ShapeError: values have the wrong shape.
        """
        requested = {}
        for name, value in reset_request(tensordict, "dynamics").items():
            check_entry(name, value, (*self.batch_size, 1), finite=False)
            requested[name] = self._taken(value)[rows, 0]
        return requested

    def _observation(self, stopped: Array) -> dict[str, dict[str, Tensor]]:
        return {**super()._observation(stopped), "truth": self._truth(stopped)}

    def _truth(self, diverged: Array) -> dict[str, Tensor]:
        state = true_state(self._snapshot(), self._places)
        truth = {
            key: self._given(value, torch.float64 if key in _DOUBLE else torch.float32)
            for key, value in state.items()
        }
        truth["diverged"] = self._given(diverged, torch.bool)[:, None]
        truth["slope"] = self._given(self._dynamics.values["slope"])[:, None]
        load, rows = state["ground_force"][..., 2], self._stones.rows
        feet = [state[f"{side}_foot_position"][:, :2] for side in SIDES]
        height = ground_height(rows, namespace(rows).stack(feet, 1), load)
        truth["ground_height"] = self._given(height)
        return truth


def _on_host(values: Array) -> np.ndarray:
    """Copy of numbers of the robots."""
    return values.copy() if is_numpy(values) else values.cpu().numpy().copy()


def reset_request(tensordict: TensorDictBase, group: str) -> dict[str, Tensor]:
    """Entries of a group of a reset request, "initial", "dynamics" or "course", by name.

    Raises:
        ShapeError: the group is not a tensordict.
    """
    entries = tensordict.get(group, None)
    if entries is None:
        return {}
    if not isinstance(entries, TensorDictBase):
        raise ShapeError(f"{group} must be a TensorDict of named entries, got {type(entries)}")
    return {str(name): cast("Tensor", value) for name, value in entries.items()}
