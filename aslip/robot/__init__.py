"""Facts about the robot Cassie: constants, names, and where its model is.

Only `aslip.robot.model` needs a simulator; import it by its own name.
"""

from aslip.robot.constants import (
    FALL_HEIGHT,
    GEAR,
    JOINT_ENCODER_BITS,
    MOTOR_ENCODER_BITS,
    MOTOR_NO_LOAD_SPEED,
    MOTOR_TORQUE_LIMIT,
    PD_DAMPING,
    PD_STIFFNESS,
    PHYSICS_TIMESTEP,
    POLICY_PERIOD,
    STANDARD_GRAVITY,
    SUBSTEPS,
    TORQUE_DELAY,
    TOTAL_MASS,
)
from aslip.robot.names import (
    JOINT_NAMES,
    MOTOR_NAMES,
    SIDES,
    SPRING_NAMES,
    Side,
    foot_site,
    mirror_name,
)

__all__ = [
    "FALL_HEIGHT",
    "GEAR",
    "JOINT_ENCODER_BITS",
    "JOINT_NAMES",
    "MOTOR_ENCODER_BITS",
    "MOTOR_NAMES",
    "MOTOR_NO_LOAD_SPEED",
    "MOTOR_TORQUE_LIMIT",
    "PD_DAMPING",
    "PD_STIFFNESS",
    "PHYSICS_TIMESTEP",
    "POLICY_PERIOD",
    "SIDES",
    "SPRING_NAMES",
    "STANDARD_GRAVITY",
    "SUBSTEPS",
    "TORQUE_DELAY",
    "TOTAL_MASS",
    "Side",
    "foot_site",
    "mirror_name",
]
