"""Values of `DYNAMICS` for n robots, and the fields of the MuJoCo model that depend on them.

The simulators write these fields, per simulation into `mujoco.batch` or into each robot's model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NoReturn

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from aslip.base.arrays import Array, copied, is_numpy, namespace
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import Prism, ground_geoms, load_model
from aslip.sim.parameters import DRIVE, DYNAMICS, parameter_named

DERIVING_FIELDS: Final = frozenset({"body_mass", "body_inertia", "dof_armature"})
"""Fields from which MuJoCo derives others: call `mj_setConst` after writing them."""


class Dynamics:
    """Values of the parameters for n robots, initially those of a model.

    Args:
        num: number of robots n.
        model: compiled model with the nominal values.
        robot: robot of the model; gives the gains.
        arranged: what makes numbers arrays of the simulator's kind.
    """

    def __init__(
        self,
        num: int,
        model: mujoco.MjModel,
        robot: Robot = CASSIE,
        arranged: Callable[[np.ndarray], Array] = np.asarray,
    ) -> None:
        self._arranged, self._robot = arranged, robot
        self.use_model(model)
        nominal = dict.fromkeys(DYNAMICS, 1.0) | {
            "payload": 0.0,
            "floor_friction": float(model.geom("floor").friction[0]),
            "torque_delay": float(model.actuator_delay[0]),
            "slope": 0.0,
        }
        self.nominal: Mapping[str, float] = MappingProxyType(nominal)
        """Parameter -> value of the model."""
        self.values = {name: arranged(np.full(num, value)) for name, value in nominal.items()}
        """Parameter -> values (n,)."""

    def use_model(self, model: mujoco.MjModel) -> None:
        """Take default fields from a model, such as one with more geoms; values stay."""
        names = sorted({field for parameter in DYNAMICS.values() for field in parameter.fields})
        robot = self._robot
        gains = {f"{DRIVE}stiffness": robot.stiffness, f"{DRIVE}damping": robot.damping}
        self._default = {
            name: self._arranged(gains[name] if name in gains else model_field(model, name).copy())
            for name in names
        }
        self._timestep = model.opt.timestep
        self._ground, self._pelvis = ground_geoms(model), model.body(robot.pelvis).id

    def update(self, ids: Array, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Change some parameters of some robots.

        A value that equals the nominal one in single precision becomes the nominal one.

        Args:
            ids: (k,) robots.
            values: parameter -> one value, or (k,) values.

        Returns:
            Field of the model -> (k, ...), for fields of changed parameters.

        Raises:
            UnknownNameError: a parameter does not exist.
            ShapeError: the number of values is neither one nor k.
            ConfigurationError: a value is outside the parameter's limits; all values stay as they
                are.
        """
        rows = {name: self._as_rows(name, ids, value) for name, value in values.items()}
        for name in _names_of_true({name: _outside(name, value) for name, value in rows.items()}):
            self._refuse(name, ids, rows[name])
        rounded = {name: self._rounded(name, value) for name, value in rows.items()}
        changed = _names_of_true({n: value != self.values[n][ids] for n, value in rounded.items()})
        for name in changed:
            self.values[name][ids] = rounded[name]
        return self.fields(ids, changed)

    def fields(self, ids: Array, parameters: Iterable[str] = DYNAMICS) -> dict[str, Array]:
        """Field of the model -> (k, ...), for fields that depend on some parameters."""
        names = {field for parameter in parameters for field in DYNAMICS[parameter].fields}
        of = {name: values[ids] for name, values in self.values.items()}
        return {name: self._field(name, of, len(ids)) for name in sorted(names)}

    def _field(self, name: str, of: Mapping[str, Array], num: int) -> Array:
        default = self._default[name]
        xp = namespace(default)
        rows = copied(xp.broadcast_to(default, (num, *default.shape)))
        if name in _SCALED_BY:
            rows *= of[_SCALED_BY[name]].reshape(num, *[1] * default.ndim)
        if name == "body_mass":
            rows[:, self._pelvis] += of["payload"]
        elif name == "geom_friction":
            rows[:, self._ground, 0] = of["floor_friction"][:, None]
        elif name == "actuator_gainprm":
            # the first parameter is the motor's gain
            rows[..., 0] *= of["motor_strength"][:, None]
        elif name == "actuator_delay":
            rows[:] = of["torque_delay"][:, None]
        elif name == "opt.gravity":
            rows[:, 0] = default[2] * xp.sin(of["slope"])
            rows[:, 2] *= xp.cos(of["slope"])
        return rows

    def _as_rows(self, name: str, ids: Array, given: Any) -> Array:
        """Values (k,) in double precision."""
        parameter_named(name)
        value = given if hasattr(given, "device") else np.asarray(given)
        if tuple(value.shape) not in ((), tuple(ids.shape)):
            raise ShapeError(
                f"{name} must be one number or have shape {ids.shape}, got shape {value.shape}"
            )
        value = self._arranged(value.astype(np.float64)) if is_numpy(value) else value.double()
        return copied(namespace(value).broadcast_to(value, ids.shape))

    def _refuse(self, name: str, ids: Array, value: Array) -> NoReturn:
        """Name the first robot whose value is outside the limits."""
        parameter = DYNAMICS[name]
        first = int(_outside(name, value).nonzero()[0][0])
        raise ConfigurationError(
            f"{name} of robot {ids[first]} must be from {parameter.low:g} to"
            f" {parameter.high:g} ({parameter.meaning}), got {value[first]:g}"
        )

    def _rounded(self, name: str, value: Array) -> Array:
        """Delays in whole physics steps, and the nominal value for those equal to it."""
        xp = namespace(value)
        if name == "torque_delay":
            value = xp.round(value / self._timestep) * self._timestep
        nominal = self.nominal[name]
        return xp.where(_single(value) == np.float32(nominal), nominal, value)


def _outside(name: str, value: Array) -> Array:
    """True where a value is outside the limits of a parameter, or NaN."""
    parameter, single = DYNAMICS[name], _single(value)
    return ~((single >= np.float32(parameter.low)) & (single <= np.float32(parameter.high)))


def _names_of_true(flags: Mapping[str, Array]) -> list[str]:
    """Names of the flags (k,) that are true for a robot.

    They are read as one number, because each number that is read waits for a device.
    """
    bits = int(sum(flag.any() * 2**k for k, flag in enumerate(flags.values())))
    return [name for k, name in enumerate(flags) if bits >> k & 1]


# overflow is beyond all limits
@np.errstate(over="ignore")
def _single(value: Array) -> Array:
    """Numbers in single precision."""
    return value.astype(np.float32) if is_numpy(value) else value.float()


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
    """Live array of a field by the name in `mujoco.batch`, such as "opt.gravity" for an option."""
    owner, _, option = name.rpartition(".")
    return getattr(model.opt if owner else model, option)


def write_fields(model: mujoco.MjModel, fields: Mapping[str, np.ndarray]) -> None:
    """Write fields into one robot's model and update the derived ones; skip gains."""
    for name, value in fields.items():
        if not name.startswith(DRIVE):
            model_field(model, name)[:] = value
    if DERIVING_FIELDS & fields.keys():
        # mj_setConst overwrites the data
        mujoco.mj_setConst(model, mujoco.MjData(model))


def longest_delay(model: mujoco.MjModel) -> float:
    """Longest torque delay that a model's memory of commands allows [s]."""
    return float(model.actuator_history[0, 0]) * model.opt.timestep


def load_again(
    model: mujoco.MjModel,
    *,
    delay: float = 0.0,
    stones: int = 0,
    prisms: Sequence[Prism] = (),
    visual: bool,
    robot: Robot = CASSIE,
) -> mujoco.MjModel:
    """Load a model again, with a longer memory of commands or with stones.

    Args:
        model: model from `aslip.robot.model.load_model` or this function.
        delay: torque delay that the memory must allow [s]; it is doubled until it does.
        stones: number of boxes; see `load_model`.
        prisms: other stones.
        visual: `visual` of the model.
        robot: robot of the model.
    """
    samples = int(model.actuator_history[0, 0])
    while samples * model.opt.timestep < delay:
        samples *= 2
    return load_model(
        float(model.geom("floor").friction[0]),
        visual=visual,
        timestep=model.opt.timestep,
        memory=samples,
        stones=stones,
        prisms=prisms,
        robot=robot,
    )


def with_memory_of(states: np.ndarray, model: mujoco.MjModel, longer: mujoco.MjModel) -> np.ndarray:
    """Convert states of a model to a model with a longer memory of commands.

    Args:
        states: (n, k) states from `aslip.sim.Simulations.states`.
        model: model of the states.
        longer: model with the longer memory.

    Returns:
        (n, l) states; the oldest command fills the longer memory.
    """
    if model.nhistory == longer.nhistory:
        return states
    start = mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_HISTORY) - 1)
    before, history, after = np.split(states, [start, start + model.nhistory], axis=1)
    old, new = (int(m.actuator_history[0, 0]) for m in (model, longer))
    # a motor's row: user number, index of the newest sample, times, commands
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
