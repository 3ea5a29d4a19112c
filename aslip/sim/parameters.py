"""Parameters of the dynamics: names, meanings and limits, readable without a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.errors import UnknownNameError
from aslip.robot import CASSIE


@dataclass(frozen=True)
class Parameter:
    """Parameter of the dynamics that may differ between robots."""

    meaning: str
    low: float
    """Smallest value."""
    high: float
    """Largest value."""
    fields: tuple[str, ...]
    """Fields of `mujoco.MjModel`, and gains of the drive, that depend on the parameter."""
    nominal: float = 1.0
    """Value of the robot's own model."""


DRIVE: Final = "drive."
"""Prefix of the fields that are gains of the drive."""

DYNAMICS: Final = MappingProxyType(
    {
        "mass": Parameter(
            "factor on the masses and inertias of all bodies",
            0.2,
            5.0,
            ("body_mass", "body_inertia"),
        ),
        "payload": Parameter(
            "point mass added at the pelvis' centre of mass [kg]", 0.0, 100.0, ("body_mass",), 0.0
        ),
        "floor_friction": Parameter("sliding friction of the floor", 0.01, 5.0, ("geom_friction",)),
        "spring_stiffness": Parameter(
            "factor on the stiffness of the leaf springs", 0.1, 10.0, ("jnt_stiffness",)
        ),
        "joint_damping": Parameter("factor on the damping of joints", 0.0, 20.0, ("dof_damping",)),
        "reflected_inertia": Parameter(
            "factor on the inertia of the motors' rotors at the joints", 0.0, 5.0, ("dof_armature",)
        ),
        "motor_strength": Parameter(
            "ratio of delivered to commanded torque, at the motors' limits, too",
            0.0,
            5.0,
            ("actuator_gainprm",),
        ),
        "torque_delay": Parameter(
            "time from a torque command to its action [s], in whole physics steps",
            0.0,
            CASSIE.substeps * CASSIE.physics_timestep,
            ("actuator_delay",),
            CASSIE.torque_delay,
        ),
        "slope": Parameter(
            "rise of the floor along the world's x [rad]", -0.7, 0.7, ("opt.gravity",), 0.0
        ),
        "pd_stiffness": Parameter(
            "factor on the position gains of the PD loop", 0.0, 10.0, ("drive.stiffness",)
        ),
        "pd_damping": Parameter(
            "factor on the velocity gains of the PD loop", 0.0, 10.0, ("drive.damping",)
        ),
        "sensor_noise": Parameter(
            "factor on the sensors' noise, applied by transforms", 0.0, 100.0, ()
        ),
    }
)
"""Parameters of `SimulatedEnv.set_dynamics`.

Motor strength scales the delivered torque and its limit, as a wrong torque constant does. A slope
keeps the floor in the plane z = 0 and turns gravity instead, so that heights, falls, references and
initial poses stay valid; the IMU's attitude is relative to gravity, as on a robot."""


def parameter_named(name: str) -> Parameter:
    """Entry of `DYNAMICS` by name.

    Raises:
        UnknownNameError: the parameter does not exist.
    """
    if name not in DYNAMICS:
        raise UnknownNameError.among("parameter", name, DYNAMICS)
    return DYNAMICS[name]
