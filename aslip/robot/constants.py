"""Numbers of the robot and its low level, one source each.

"Simulator" is the public Cassie simulator that the paper names (footnote 1 of Green et al. 2021).
Arrays hold one value per motor in motor order: hip roll, hip yaw, hip pitch, knee, foot; left leg,
then right leg. They are read-only.
"""

from __future__ import annotations

from typing import Final

import numpy as np


def _both_legs(*values: float) -> np.ndarray:
    """Read-only array of both legs from one leg's values."""
    array = np.array(values * 2, dtype=np.float64)
    array.setflags(write=False)
    return array


TOTAL_MASS: Final = 33.312
"""Mass of the robot [kg] (sum of the simulator's bodies)."""

STANDARD_GRAVITY: Final = 9.81
"""Of the model and of the reduced-order model [m/s^2] (Table I)."""

PHYSICS_TIMESTEP: Final = 0.0005
"""Physics and PD period [s]: the loop runs at 2 kHz (Sec. III-B)."""

SUBSTEPS: Final = 60
"""Physics steps per policy step: 30 ms, the paper's 33 Hz (Fig. 2)."""

POLICY_PERIOD: Final = SUBSTEPS * PHYSICS_TIMESTEP
"""Time between two actions [s]."""

TORQUE_DELAY: Final = 6 * PHYSICS_TIMESTEP
"""A torque command acts after this time [s]: "0.003 seconds (6 time steps ...)" (Sec. IV-A)."""

PD_STIFFNESS: Final = _both_legs(100.0, 100.0, 88.0, 96.0, 50.0)
"""Position gains at the joint [N m/rad] (simulator; the paper calls them fixed, Sec. III-B)."""

PD_DAMPING: Final = _both_legs(10.0, 10.0, 8.0, 9.6, 5.0)
"""Velocity gains at the joint [N m s/rad]; the velocity target is always zero (Sec. III-B)."""

GEAR: Final = _both_legs(25.0, 25.0, 16.0, 16.0, 50.0)
"""Motor turns per joint turn (simulator)."""

MOTOR_TORQUE_LIMIT: Final = _both_legs(4.5, 4.5, 12.2, 12.2, 0.9)
"""Largest torque at the motor shaft [N m] (simulator)."""

MOTOR_NO_LOAD_SPEED: Final = _both_legs(2900.0, 2900.0, 1300.0, 1300.0, 5500.0) * (2 * np.pi / 60)
"""Motor speed at which no torque is left [rad/s], from rpm (simulator)."""
MOTOR_NO_LOAD_SPEED.setflags(write=False)

MOTOR_ENCODER_BITS: Final = _both_legs(13, 13, 13, 13, 18)
"""A motor's encoder counts so many bits in a turn of the motor, not of the joint (simulator)."""

JOINT_ENCODER_BITS: Final = _both_legs(18, 18, 13)
"""Those of shin, tarsus and foot, in a turn of the joint (simulator)."""

FALL_HEIGHT: Final = 0.4
"""Height of the pelvis below which the robot has fallen [m] (public code of Green et al. 2021)."""
