"""Values of `DYNAMICS` for n robots, and the numbers of the MuJoCo model that follow from them.

Who steps the robots writes those numbers, into per-simulation fields of `mujoco.batch` or into a
model of each robot's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import load_model
from aslip.sim.parameters import DRIVE, DYNAMICS, parameter_named

DERIVING_FIELDS: Final = frozenset({"body_mass", "body_inertia", "dof_armature"})
"""Fields from which others follow: call `mj_setConst` after writing them."""


class Dynamics:
    """Values of the parameters for n robots, at first those of a model.

    Args:
        num: number of robots n.
        model: compiled model of the robot as it is by default.
        robot: the robot, which has the gains.
    """

    def __init__(self, num: int, model: mujoco.MjModel, robot: Robot = CASSIE) -> None:
        names = sorted({field for parameter in DYNAMICS.values() for field in parameter.fields})
        gains = {f"{DRIVE}stiffness": robot.stiffness, f"{DRIVE}damping": robot.damping}
        self._default = {
            name: gains[name] if name in gains else model_field(model, name).copy()
            for name in names
        }
        self._timestep = model.opt.timestep
        self._floor, self._pelvis = model.geom("floor").id, model.body(robot.pelvis).id
        nominal = dict.fromkeys(DYNAMICS, 1.0) | {
            "payload": 0.0,
            "floor_friction": float(self._default["geom_friction"][self._floor, 0]),
            "torque_delay": float(self._default["actuator_delay"][0]),
            "slope": 0.0,
        }
        self.nominal: Mapping[str, float] = MappingProxyType(nominal)
        """Values that leave the model as it is."""
        self.values = {name: np.full(num, value) for name, value in nominal.items()}
        """(n,) each."""

    def update(self, ids: np.ndarray, values: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
        """Change some parameters of some robots.

        A value that is the nominal one in single precision is taken for the nominal one.

        Args:
            ids: (k,) robots.
            values: parameter -> one value, or (k,).

        Returns:
            (k, ...) of each field of the model that is not what it was.

        Raises:
            UnknownNameError: there is no such parameter.
            ShapeError: the values are not one or k.
            ConfigurationError: a value is outside the parameter's limits; nothing has been changed
                then.
        """
        checked = {name: self._checked(name, ids, value) for name, value in values.items()}
        changed = {name for name in checked if (checked[name] != self.values[name][ids]).any()}
        for name in changed:
            self.values[name][ids] = checked[name]
        return self.fields(ids, changed)

    def fields(
        self, ids: np.ndarray, parameters: Iterable[str] = DYNAMICS
    ) -> dict[str, np.ndarray]:
        """(k, ...) of each field of the model that some parameters bear on, for some robots."""
        names = {field for parameter in parameters for field in DYNAMICS[parameter].fields}
        of = {name: values[ids] for name, values in self.values.items()}
        return {name: self._field(name, of, len(ids)) for name in sorted(names)}

    def _field(self, name: str, of: Mapping[str, np.ndarray], num: int) -> np.ndarray:
        default = self._default[name]
        rows = np.broadcast_to(default, (num, *default.shape)).copy()
        if name in _SCALED_BY:
            rows *= of[_SCALED_BY[name]].reshape(num, *[1] * default.ndim)
        if name == "body_mass":
            rows[:, self._pelvis] += of["payload"]
        elif name == "geom_friction":
            rows[:, self._floor, 0] = of["floor_friction"]
        elif name == "actuator_gainprm":
            # a motor's gain is the first of the numbers
            rows[..., 0] *= of["motor_strength"][:, None]
        elif name == "actuator_delay":
            rows[:] = of["torque_delay"][:, None]
        elif name == "opt.gravity":
            rows[:, 0] = default[2] * np.sin(of["slope"])
            rows[:, 2] *= np.cos(of["slope"])
        return rows

    def _checked(self, name: str, ids: np.ndarray, given: ArrayLike) -> np.ndarray:
        parameter = parameter_named(name)
        value = np.asarray(given)
        if value.shape not in ((), ids.shape):
            raise ShapeError(
                f"{name} must be one number or {ids.shape} of them, got the shape {value.shape}"
            )
        value = np.broadcast_to(value.astype(np.float64), ids.shape).copy()
        with np.errstate(over="ignore"):  # what overflows is beyond all limits
            single, low, high = (np.float32(x) for x in (value, parameter.low, parameter.high))
        wrong = ~((single >= low) & (single <= high))
        if wrong.any():
            first = int(np.flatnonzero(wrong)[0])
            raise ConfigurationError(
                f"{name} of robot {ids[first]} must be from {parameter.low:g} to"
                f" {parameter.high:g} ({parameter.meaning}), got {value[first]:g}"
            )
        if name == "torque_delay":
            value = np.rint(value / self._timestep) * self._timestep
        nominal = self.nominal[name]
        value[np.float32(value) == np.float32(nominal)] = nominal
        return value


_SCALED_BY = {
    "body_mass": "mass",
    "body_inertia": "mass",
    "jnt_stiffness": "spring_stiffness",
    "dof_damping": "joint_damping",
    "dof_armature": "reflected_inertia",
    "drive.stiffness": "pd_stiffness",
    "drive.damping": "pd_damping",
}


def model_field(model: mujoco.MjModel, name: str) -> np.ndarray:
    """The live array of a field, which `mujoco.batch` names "opt.gravity" if it is an option."""
    owner, _, option = name.rpartition(".")
    return getattr(model.opt if owner else model, option)


def write_fields(model: mujoco.MjModel, fields: Mapping[str, np.ndarray]) -> None:
    """Write fields into one robot's model, and what follows from them; gains are skipped."""
    for name, value in fields.items():
        if not name.startswith(DRIVE):
            model_field(model, name)[:] = value
    if DERIVING_FIELDS & fields.keys():
        # the data is overwritten in the course of it
        mujoco.mj_setConst(model, mujoco.MjData(model))


def longest_delay(model: mujoco.MjModel) -> float:
    """The longest torque delay that a model's memory of commands is long enough for [s]."""
    return float(model.actuator_history[0, 0]) * model.opt.timestep


def with_longer_memory(
    model: mujoco.MjModel, delay: float, *, visual: bool, robot: Robot = CASSIE
) -> mujoco.MjModel:
    """The same robot with a memory of commands that is doubled until it is long enough.

    Args:
        model: as `aslip.robot.model.load_model` made it, or this.
        delay: torque delay that it must be long enough for [s].
        visual: what it was made with.
        robot: robot that the model is of.
    """
    samples = int(model.actuator_history[0, 0])
    while samples * model.opt.timestep < delay:
        samples *= 2
    return load_model(
        float(model.geom("floor").friction[0]),
        visual=visual,
        timestep=model.opt.timestep,
        memory=samples,
        robot=robot,
    )


def with_memory_of(states: np.ndarray, model: mujoco.MjModel, longer: mujoco.MjModel) -> np.ndarray:
    """States of one model as states of another, whose memory of commands is longer.

    Args:
        states: (n, k) as `aslip.sim.Simulations.states` returns them.
        model: theirs.
        longer: the other.

    Returns:
        (n, l). What the longer memory has no commands for is the oldest there is.
    """
    start = mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_HISTORY) - 1)
    before, history, after = np.split(states, [start, start + model.nhistory], axis=1)
    old, new = (int(m.actuator_history[0, 0]) for m in (model, longer))
    # of each motor: a number for users, the newest sample's place, times, commands
    rows = history.reshape(len(states), model.nu, 2 + 2 * old)
    newest = rows[..., 1:2].astype(int)
    oldest_first = (newest + 1 + np.arange(old)) % old
    time, command = (
        np.take_along_axis(part, oldest_first, axis=-1)
        for part in np.split(rows[..., 2:], 2, axis=-1)
    )
    missing = new - old
    earlier = time[..., :1] - model.opt.timestep * np.arange(missing, 0, -1)
    padding = [(0, 0), (0, 0), (missing, 0)]
    longer_rows = np.concatenate(
        [
            rows[..., :1],
            np.full_like(rows[..., 1:2], new - 1),
            np.concatenate([earlier, time], axis=-1),
            np.pad(command, padding, mode="edge"),
        ],
        axis=-1,
    )
    return np.concatenate([before, longer_rows.reshape(len(states), -1), after], axis=1)
