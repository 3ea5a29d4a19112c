"""Parameters of the dynamics: names, meanings and limits; no simulator is imported."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.errors import UnknownNameError
from aslip.robot import CASSIE


@dataclass(frozen=True)
class Parameter:
    """Something that differs from robot to robot."""

    meaning: str
    low: float
    """The least value that makes sense."""
    high: float
    """The greatest."""
    fields: tuple[str, ...]
    """Fields of `mujoco.MjModel` that follow from it, and gains of the drive."""


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
            "point mass added at the pelvis' centre of mass [kg]", 0.0, 100.0, ("body_mass",)
        ),
        "floor_friction": Parameter("sliding friction of the floor", 0.01, 5.0, ("geom_friction",)),
        "spring_stiffness": Parameter(
            "factor on the stiffness of joints, which are the leaf springs'",
            0.1,
            10.0,
            ("jnt_stiffness",),
        ),
        "joint_damping": Parameter("factor on the damping of joints", 0.0, 20.0, ("dof_damping",)),
        "reflected_inertia": Parameter(
            "factor on the inertia of the motors' rotors at the joints", 0.0, 5.0, ("dof_armature",)
        ),
        "motor_strength": Parameter(
            "delivered over commanded torque, below the motors' limits and at them",
            0.0,
            5.0,
            ("actuator_gainprm",),
        ),
        "torque_delay": Parameter(
            "from a torque command to its action [s], in whole physics steps",
            0.0,
            CASSIE.substeps * CASSIE.physics_timestep,
            ("actuator_delay",),
        ),
        "slope": Parameter(
            "rise of the floor along the world's x [rad]", -0.7, 0.7, ("opt.gravity",)
        ),
        "pd_stiffness": Parameter(
            "factor on the position gains of the PD loop", 0.0, 10.0, ("drive.stiffness",)
        ),
        "pd_damping": Parameter(
            "factor on the velocity gains of the PD loop", 0.0, 10.0, ("drive.damping",)
        ),
        "sensor_noise": Parameter(
            "factor on the sensors' noise, which transforms add: remembered here only",
            0.0,
            100.0,
            (),
        ),
    }
)
"""What `SimulatedEnv.set_dynamics` takes.

Motor strength scales all that is delivered, not only its limit, as a wrong torque constant does. On
a slope the floor stays the plane z = 0 and gravity leans back, so that heights above the floor,
falls, the reference and poses at resets remain what they are; the IMU's attitude is against
gravity, as a robot's."""


def parameter_named(name: str) -> Parameter:
    """The entry of `DYNAMICS`.

    Raises:
        UnknownNameError: it has none of that name.
    """
    if name not in DYNAMICS:
        raise UnknownNameError.among("parameter", name, DYNAMICS)
    return DYNAMICS[name]
