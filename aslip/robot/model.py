"""MuJoCo model of a robot."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from types import FunctionType
from typing import Final, NamedTuple

import mujoco
import numpy as np

from aslip.errors import ConfigurationError
from aslip.robot.cassie import CASSIE
from aslip.robot.robot import Robot

DEFAULT_FLOOR_FRICTION = 1.0
"""Sliding friction of the floor (the public simulator's default)."""
HIGHEST_FRICTION = 1e3
"""Highest sliding friction of a floor; dry rubber reaches about 1."""

APPEARANCE_GROUP: Final = 1
"""Group of the robot's visual geoms."""

STONE_GEOM: Final = "stone:"
"""Prefix of the names of stones that are boxes."""
PRISM_GEOM: Final = "prism:"
"""Prefix of the names of stones that are other prisms."""
AWAY: Final = -100.0
"""Height of what a robot does not have [m]."""
_STONE_COLOR = (0.66, 0.62, 0.55, 1.0)

_log = logging.getLogger(__name__)
_warned = False


def _warn_once(message: str) -> None:
    """Log MuJoCo's first warning in this process; an exception here would abort the process."""
    global _warned
    if not _warned:
        _warned = True
        _log.warning("MuJoCo: %s Further warnings of MuJoCo are not shown.", message)


def limit_warnings() -> None:
    """Show one of MuJoCo's warnings only, such as those of each simulation that diverges.

    MuJoCo appends each to the file MUJOCO_LOG.TXT in the working directory, and dm_control, whose
    import sets its own handler, logs it. A handler in Python that a user has set stays.
    """
    if not isinstance(mujoco.get_mju_user_warning(), FunctionType):
        mujoco.set_mju_user_warning(_warn_once)


limit_warnings()


class Prism(NamedTuple):
    """Upright prism on a convex polygon."""

    corners: tuple[tuple[float, float], ...]
    """Corners of the polygon [m]."""
    ends: tuple[float, float]
    """Heights of bottom and top [m]."""


def load_model(
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    *,
    visual: bool = True,
    timestep: float | None = None,
    memory: int | None = None,
    stones: int = 0,
    prisms: Sequence[Prism] = (),
    robot: Robot = CASSIE,
) -> mujoco.MjModel:
    """Compile a robot's MJCF.

    Args:
        floor_friction: sliding friction coefficient between the floor and any part of the robot.
        visual: keep visual geoms; without them the physics is the same, bit for bit, and faster.
        timestep: physics timestep [s]: the robot's by default, or twice that for faster training.
        memory: number of delayed torque commands per motor, one per physics step; by default
            enough for the robot's delay.
        stones: number of boxes, all far below the floor, that `aslip.sim.stones` makes stones.
        prisms: stones that are not boxes, at their places.
        robot: robot to compile.

    Raises:
        ConfigurationError: the friction is not a positive number, or the timestep is not one of
            the two.
    """
    timestep = robot.physics_timestep if timestep is None else timestep
    check_timestep(timestep, robot)
    limit_warnings()
    spec = mujoco.MjSpec.from_file(str(robot.mjcf))
    spec.compiler.discardvisual = not visual
    spec.option.timestep = timestep
    if memory is not None:
        for actuator in spec.actuators:
            actuator.nsample = memory
    if stones or prisms:
        _add_stones(spec, stones, prisms)
    model = spec.compile()
    set_floor_friction(model, floor_friction)
    return model


def _add_stones(spec: mujoco.MjSpec, stones: int, prisms: Sequence[Prism]) -> None:
    """Add stones like the floor, so that places and sizes of each may be changed afterwards."""
    floor = spec.geom("floor")
    # not at the body's origin, where MuJoCo would ignore places written later
    floor.pos = [0.0, 0.0, AWAY]
    # midphase searches a tree of bounds, which would keep the places of the compiled model
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    shared = ("condim", "contype", "conaffinity", "friction", "priority", "solref", "solimp")
    settings = {name: getattr(floor, name) for name in shared} | {"rgba": _STONE_COLOR}
    turned = [np.cos(0.5), 0.0, 0.0, np.sin(0.5)]
    for i in range(stones):
        box = {"pos": floor.pos, "quat": turned, "size": [0.01] * 3}
        spec.worldbody.add_geom(
            name=f"{STONE_GEOM}{i}", type=mujoco.mjtGeom.mjGEOM_BOX, **box, **settings
        )
    for i, prism in enumerate(prisms):
        name = f"{PRISM_GEOM}{i}"
        ends = [np.pad(prism.corners, [(0, 0), (0, 1)], constant_values=z) for z in prism.ends]
        spec.add_mesh(name=name, uservert=np.concatenate(ends).ravel())
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **settings
        )
    for sensor in spec.sensors:
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT and sensor.objname == floor.name:
            # floor and stones are the geoms of the world
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, "world"


def ground_geoms(model: mujoco.MjModel, *kinds: str) -> np.ndarray:
    """Ids of the floor and all stones; or only of those of some kinds, such as `STONE_GEOM`."""
    kinds = kinds or ("floor", STONE_GEOM, PRISM_GEOM)
    names = [model.geom(i).name.rstrip("0123456789") for i in range(model.ngeom)]
    return np.array([i for i, name in enumerate(names) if name in kinds], dtype=int)


def physics_timesteps(robot: Robot = CASSIE) -> tuple[float, float]:
    """Allowed physics timesteps [s]; the period of the PD loop is the same with both."""
    return robot.physics_timestep, 2 * robot.physics_timestep


def check_timestep(timestep: float, robot: Robot = CASSIE) -> None:
    """Check a physics timestep.

    Raises:
        ConfigurationError: the timestep is not allowed.
    """
    allowed = physics_timesteps(robot)
    if timestep not in allowed:
        raise ConfigurationError(f"timestep must be one of {allowed} s, got {timestep!r}")


def set_floor_friction(model: mujoco.MjModel, friction: float) -> None:
    """Set the friction of floor and stones, which has priority over that of the robot's geoms."""
    if not 0 < friction <= HIGHEST_FRICTION:
        raise ConfigurationError(
            f"floor_friction must be a positive number up to {HIGHEST_FRICTION:g}, got {friction!r}"
        )
    model.geom_friction[ground_geoms(model), 0] = friction


def geom_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Colour (4,) of a geom, red, green, blue and opacity, or of its material."""
    material = model.geom_matid[geom]
    return model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
