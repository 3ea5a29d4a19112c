"""The MuJoCo model of Cassie and the indices of its parts, resolved once by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from aslip.errors import ConfigurationError
from aslip.files.assets import asset_path
from aslip.robot.constants import PHYSICS_TIMESTEP
from aslip.robot.names import JOINT_NAMES, MOTOR_NAMES, SIDES, foot_site

DEFAULT_FLOOR_FRICTION = 1.0
"""Sliding friction of the floor (the public simulator's default)."""

TIMESTEPS: Final = (PHYSICS_TIMESTEP, 2 * PHYSICS_TIMESTEP)
"""Timesteps that physics may have [s]; motors are controlled at 2 kHz with both."""


APPEARANCE_GROUP: Final = 1
"""Group of geoms that are what one sees of the robot."""


def load_model(
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    *,
    visual: bool = True,
    timestep: float = PHYSICS_TIMESTEP,
    memory: int | None = None,
) -> mujoco.MjModel:
    """Compile `assets/cassie.xml`.

    Args:
        floor_friction: sliding friction coefficient between the floor and any part of the robot.
        visual: keep what is only looked at. Without it the physics is the same, bit for bit, and a
            physics step costs less.
        timestep: of the physics [s], that of the 2 kHz loop or twice that, to train on.
        memory: torque commands that a motor remembers, one a physics step; enough for the delay of
            the robot by default.

    Raises:
        ConfigurationError: the friction is not a positive number, or the timestep none of the two.
    """
    check_timestep(timestep)
    spec = mujoco.MjSpec.from_file(str(asset_path("cassie.xml")))
    spec.compiler.discardvisual = not visual
    spec.option.timestep = timestep
    if memory is not None:
        for actuator in spec.actuators:
            actuator.nsample = memory
    model = spec.compile()
    set_floor_friction(model, floor_friction)
    return model


def check_timestep(timestep: float) -> None:
    """Raise ConfigurationError if physics cannot have it."""
    if timestep not in TIMESTEPS:
        raise ConfigurationError(f"timestep must be one of {TIMESTEPS} s, got {timestep!r}")


def set_floor_friction(model: mujoco.MjModel, friction: float) -> None:
    """Give the floor a sliding friction; it has priority over the friction of the robot's geoms."""
    if not (np.isfinite(friction) and friction > 0):
        raise ConfigurationError(f"floor_friction must be a positive number, got {friction!r}")
    model.geom("floor").friction[0] = friction


def geom_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """(4,) red, green, blue and opacity of a geom: its material's, if it has one."""
    material = model.geom_matid[geom]
    return model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]


@dataclass(frozen=True)
class CassieIndices:
    """Where the robot's parts are in MuJoCo's arrays, in the order of `aslip.robot.names`."""

    motor_qpos: np.ndarray
    """(10,) positions of the motors' joints in `qpos`."""
    motor_qvel: np.ndarray
    """(10,) the same in `qvel`."""
    joint_qpos: np.ndarray
    """(6,) positions of the passive joints with encoders in `qpos`."""
    joint_qvel: np.ndarray
    """(6,) the same in `qvel`."""
    foot_site: np.ndarray
    """(2,) ids of the sole-centre sites."""
    ground_force: np.ndarray
    """(2, 3) ground reaction of each foot in `sensordata`, world frame."""
    foot_velocity: np.ndarray
    """(2, 3) velocity of each sole centre in `sensordata`, world frame."""
    pelvis_body: int
    """Id of the pelvis, whose origin is pushed."""

    @classmethod
    def from_model(cls, model: mujoco.MjModel) -> CassieIndices:
        """Look every name up in a compiled model."""
        tables = cls(
            motor_qpos=np.array([model.joint(name).qposadr[0] for name in MOTOR_NAMES]),
            motor_qvel=np.array([model.joint(name).dofadr[0] for name in MOTOR_NAMES]),
            joint_qpos=np.array([model.joint(name).qposadr[0] for name in JOINT_NAMES]),
            joint_qvel=np.array([model.joint(name).dofadr[0] for name in JOINT_NAMES]),
            foot_site=np.array([model.site(foot_site(side)).id for side in SIDES]),
            ground_force=np.stack([_sensor(model, f"{side}_ground_force") for side in SIDES]),
            foot_velocity=np.stack([_sensor(model, f"{side}_foot_velocity") for side in SIDES]),
            pelvis_body=model.body("pelvis").id,
        )
        for table in vars(tables).values():
            if isinstance(table, np.ndarray):
                table.setflags(write=False)
        return tables


def _sensor(model: mujoco.MjModel, name: str) -> np.ndarray:
    sensor = model.sensor(name)
    return sensor.adr[0] + np.arange(sensor.dim[0])
