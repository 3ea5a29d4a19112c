"""Biped Cassie: numbers of the robot and its low level, each with its source.

"Simulator" is the public Cassie simulator that the paper names (footnote 1 of Green et al. 2021).
A leg's motors are hip roll, hip yaw, hip pitch, knee and foot.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from aslip.robot.names import SIDES
from aslip.robot.noise import NoiseLevel
from aslip.robot.robot import Robot

_TIMESTEP = 0.0005
# revolutions per minute
_RPM = 2 * np.pi / 60


def _both_legs(*values: float) -> np.ndarray:
    """Array of both legs from one leg's values."""
    return np.array(values * 2, dtype=np.float64)


def _names(*parts: str) -> tuple[str, ...]:
    """Names of both legs' parts from those of one leg."""
    return tuple(f"{side}_{part}" for side in SIDES for part in parts)


CASSIE: Final = Robot(
    model_file="cassie.xml",
    motor_names=_names("hip_roll", "hip_yaw", "hip_pitch", "knee", "foot"),
    # the foot has both encoders
    joint_names=_names("shin", "tarsus", "foot"),
    spring_names=_names("shin", "heel_spring"),
    foot_sites=("left_foot", "right_foot"),
    pelvis="pelvis",
    imu_site="imu",
    # simulator; the paper calls the gains fixed, Sec. III-B
    stiffness=_both_legs(100.0, 100.0, 88.0, 96.0, 50.0),
    damping=_both_legs(10.0, 10.0, 8.0, 9.6, 5.0),
    # simulator
    gear=_both_legs(25.0, 25.0, 16.0, 16.0, 50.0),
    torque_limit=_both_legs(4.5, 4.5, 12.2, 12.2, 0.9),
    no_load_speed=_both_legs(2900.0, 2900.0, 1300.0, 1300.0, 5500.0) * _RPM,
    motor_encoder_bits=_both_legs(13, 13, 13, 13, 18),
    joint_encoder_bits=_both_legs(18, 18, 13),
    # the loop runs at 2 kHz (Sec. III-B)
    physics_timestep=_TIMESTEP,
    # 30 ms, the paper's 33 Hz (Fig. 2)
    substeps=60,
    # 333 Hz
    packet_substeps=6,
    # "0.003 seconds (6 time steps ...)" (Sec. IV-A)
    torque_delay=6 * _TIMESTEP,
    # sum of the simulator's bodies
    total_mass=33.312,
    # public code of Green et al. 2021
    fall_height=0.4,
    # The model file of the public simulator declares the white noise of the shin and tarsus
    # encoders, gyro and accelerometer; the simulator never switches it on. It declares no other
    # noise, so we choose:
    #
    # - Motor and foot encoders have no noise beyond their quantisation.
    # - Encoders have no bias: they are absolute, and calibrated at start-up.
    # - Joint velocities have the encoders' noise after the filter that computes them from angles
    #   at 2 kHz (`aslip.sim.sensors.JOINT_VELOCITY_FILTER`): 74 /s times 2e-4 rad, where 74 /s is
    #   the square root of the sum of the filter's squared impulse response. From packet to packet
    #   it is nearly white (correlation 0.08).
    # - Motor velocities have no noise, as their encoders have none.
    # - The orientation is the output of a filter in an inertial unit rated to 0.5 degrees
    #   (9e-3 rad); its error is well below the rating, and varies slowly between packets.
    # - Gyro and accelerometer have a bias of twice their white noise: over the ten packets of a
    #   policy step the white noise averages out to a third, so that the bias dominates.
    sensor_noise={
        "motor_position": NoiseLevel(),
        "motor_velocity": NoiseLevel(),
        "joint_position": NoiseLevel(white=(2e-4, 2e-4, 0.0) * 2),
        "joint_velocity": NoiseLevel(white=(1.48e-2, 1.48e-2, 0.0) * 2),
        "orientation": NoiseLevel(white=5e-4, bias=1.5e-3),
        "gyro": NoiseLevel(white=5e-4, bias=1e-3),
        "accelerometer": NoiseLevel(white=1e-2, bias=2e-2),
    },
)
"""Cassie of Agility Robotics, with the numbers of the paper's simulator."""
