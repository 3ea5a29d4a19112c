"""MuJoCo model of a robot."""

from __future__ import annotations

import logging
from types import FunctionType
from typing import Final

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


def load_model(
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    *,
    visual: bool = True,
    timestep: float | None = None,
    memory: int | None = None,
    robot: Robot = CASSIE,
) -> mujoco.MjModel:
    """Compile a robot's MJCF.

    Args:
        floor_friction: sliding friction coefficient between the floor and any part of the robot.
        visual: keep visual geoms; without them the physics is the same, bit for bit, and faster.
        timestep: physics timestep [s]: the robot's by default, or twice that for faster training.
        memory: number of delayed torque commands per motor, one per physics step; by default
            enough for the robot's delay.
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
    model = spec.compile()
    set_floor_friction(model, floor_friction)
    return model


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
    """Set the floor's sliding friction, which has priority over that of the robot's geoms."""
    if not 0 < friction <= HIGHEST_FRICTION:
        raise ConfigurationError(
            f"floor_friction must be a positive number up to {HIGHEST_FRICTION:g}, got {friction!r}"
        )
    model.geom("floor").friction[0] = friction


def geom_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Colour (4,) of a geom, red, green, blue and opacity, or of its material."""
    material = model.geom_matid[geom]
    return model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
