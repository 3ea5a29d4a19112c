"""`Robot`: MJCF, names, low level, sensors and timing of a biped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from aslip.base.assets import asset_path, user_path
from aslip.robot.names import SIDES
from aslip.robot.noise import NoiseLevel
from aslip.robot.skeleton import Skeleton, read_skeleton

LARGEST: Final[Mapping[str, float]] = MappingProxyType(
    {
        # joints turn less than one and a half turns
        "motor_position": 9.0,
        "motor_velocity": 40.0,
        "joint_position": 9.0,
        "joint_velocity": 60.0,
        "orientation": 1.01,
        # ranges of the public simulator's gyro and accelerometer
        "gyro": 34.9,
        "accelerometer": 157.0,
        "angular_velocity": 34.9,
        # of the pelvis' origin, away from the accelerometer
        "acceleration": 300.0,
        # falls from standing end below 5 m/s
        "velocity": 20.0,
        "height": 2.0,
        # beyond, single precision no longer resolves a centimetre
        "position": 1e5,
    }
)
"""Entry of packets and estimates -> largest absolute value that a robot can have, with a margin
[SI units]; greater ones are faults of a device or of its driver."""
STANDARD_GRAVITY: Final = 9.81
"""Gravity of robots and reduced-order models [m/s^2] (Table I)."""
UNIT_TOLERANCE: Final = 0.02
"""Tolerance on the squared norm of the quaternion of an attitude."""
# depth of the pelvis below the ground by errors of the estimated height [m]
_DEEPEST = 0.5


def is_possible(name: str, values: np.ndarray) -> np.ndarray:
    """Check (*b,) that readings or estimates are finite and such as a robot can have.

    Args:
        name: entry of packets or estimates, see `LARGEST`.
        values: (*b, k) its numbers.
    """
    good = (np.abs(values) <= LARGEST[name]).all(-1)
    if name == "orientation":
        # clipped, because the squares of the largest numbers overflow
        length = (np.clip(values, -2.0, 2.0) ** 2).sum(-1)
        good &= np.abs(length - 1) <= UNIT_TOLERANCE
    if name == "height":
        good &= values[..., 0] >= -_DEEPEST
    return np.asarray(good)


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """Biped with position-controlled motors, encoders and an inertial unit.

    A second robot is an MJCF and an instance of this class. `aslip.ik`, `aslip.library`,
    `aslip.sim` and `aslip.envs.BatchEnv` work with any, `aslip.estimation` and
    `aslip.ik.LegTable` with Cassie's legs; whatever is above them, such as transforms, policies
    and logs, is for Cassie only.

    Names are those of the MJCF, left before right. Arrays hold one value per motor, or per joint
    with an encoder, in the order of the names, and are read-only.

    The MJCF has a free joint at the pelvis, a keyframe `standing`, a geom `floor`, and for each
    side the sensors `SIDE_ground_force` and `SIDE_foot_velocity`.
    """

    model_file: str | Path
    """MJCF: a path, or the name of a shipped asset."""
    motor_names: tuple[str, ...]
    """Motors; each drives the joint of the same name."""
    joint_names: tuple[str, ...]
    """Joints with an encoder on the joint itself."""
    spring_names: tuple[str, ...]
    """Joints that are leaf springs."""
    foot_sites: tuple[str, str]
    """Sites at the centres of the soles: x to the toes and z up when level."""
    pelvis: str
    """Body with a free joint of the same name."""
    imu_site: str
    """Site of the inertial unit, whose axes are the pelvis'."""

    stiffness: np.ndarray
    """Position gains of the PD loop at the joint [N m/rad]."""
    damping: np.ndarray
    """Velocity gains of the PD loop at the joint [N m s/rad]; the velocity target is zero."""
    gear: np.ndarray
    """Motor turns per joint turn."""
    torque_limit: np.ndarray
    """Largest torque at the motor shaft [N m]."""
    no_load_speed: np.ndarray
    """Motor speed at which the torque limit is zero [rad/s]."""
    motor_encoder_bits: np.ndarray
    """Bits of the motor encoders, per turn of the motor."""
    joint_encoder_bits: np.ndarray
    """Bits of the joint encoders, per turn of the joint."""

    physics_timestep: float
    """Period of the PD loop, and of physics unless a coarser one is chosen [s]."""
    substeps: int
    """Substeps, ticks of the PD loop, per policy step."""
    packet_substeps: int
    """Substeps between sensor packets."""
    torque_delay: float
    """Time from a torque command to its action [s]."""

    total_mass: float
    """Mass [kg]."""
    fall_height: float
    """Height of the pelvis below which the robot has fallen [m]."""
    sensor_noise: Mapping[str, NoiseLevel]
    """Sensor -> noise that `aslip.transforms.ObservationNoise` adds by default."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, _read_only(value))

    def __repr__(self) -> str:
        """Class and name of the robot."""
        return f"{type(self).__name__}({self.name!r})"

    @property
    def name(self) -> str:
        """Name of the MJCF, without its ending."""
        return Path(self.model_file).stem

    @property
    def mjcf(self) -> Path:
        """Path of the MJCF.

        Raises:
            AssetError: the package ships no file of that name.
        """
        file = self.model_file
        return user_path(file) if isinstance(file, Path) else asset_path(file)

    @property
    def policy_period(self) -> float:
        """Time between two actions [s]."""
        return self.substeps * self.physics_timestep

    @property
    def packet_period(self) -> float:
        """Time between sensor packets [s]."""
        return self.packet_substeps * self.physics_timestep

    @property
    def sensor_window(self) -> int:
        """Packets per policy period; the newest is read at the start of the last substep."""
        return self.substeps // self.packet_substeps

    @cached_property
    def packet_sizes(self) -> dict[str, int]:
        """Entry of a packet -> size, in the order of the packet's numbers.

        Motors and joints [rad, rad/s], orientation (pelvis to world, wxyz), angular velocity
        [rad/s] and specific force [m/s^2] of the IMU, whose axes are the pelvis'.
        """
        motors, joints = len(self.motor_names), len(self.joint_names)
        encoders = {
            "motor_position": motors,
            "motor_velocity": motors,
            "joint_position": joints,
            "joint_velocity": joints,
        }
        return {**encoders, "orientation": 4, "gyro": 3, "accelerometer": 3}

    @cached_property
    def packet_slices(self) -> dict[str, slice]:
        """Entry of a packet -> slice of the packet's numbers."""
        ends = np.cumsum([0, *self.packet_sizes.values()]).tolist()
        return {name: slice(*ends[i : i + 2]) for i, name in enumerate(self.packet_sizes)}

    @property
    def packet_size(self) -> int:
        """Length of a packet as an array."""
        return sum(self.packet_sizes.values())

    @cached_property
    def estimate_sizes(self) -> dict[str, int]:
        """Entry of an estimate -> size, in order; see `aslip.transforms.ESTIMATE_SIZES`."""
        encoders = ("motor_position", "motor_velocity", "joint_position", "joint_velocity")
        return {
            "height": 1,
            "orientation": 4,
            "velocity": 3,
            "angular_velocity": 3,
            "acceleration": 3,
            **{name: self.packet_sizes[name] for name in encoders},
        }

    @cached_property
    def noise_channels(self) -> dict[str, int]:
        """Sensor -> number of error channels; the orientation's error is a rotation vector."""
        return {**self.packet_sizes, "orientation": 3}

    @cached_property
    def skeleton(self) -> Skeleton:
        """Skeleton of the MJCF, from the JSON file beside it or compiled by MuJoCo."""
        found = read_skeleton(self.mjcf, self.mjcf.with_suffix(".json"))
        if found is not None:
            return found
        from aslip.robot.compile import compile_skeleton  # needs MuJoCo

        return compile_skeleton(self.mjcf)

    @cached_property
    def indices(self) -> Indices:
        """Places of the robot's parts in MuJoCo's arrays."""
        return Indices.of(self)

    @cached_property
    def standing(self) -> np.ndarray:
        """Configuration `qpos` of a robot that stands upright."""
        return _read_only(self.skeleton.standing)


@dataclass(frozen=True, eq=False)
class Indices:
    """Places of a robot's parts in MuJoCo's arrays, in the order of the robot's names."""

    num_qpos: int
    """Length of `qpos`."""
    num_qvel: int
    """Length of `qvel`."""
    motor_qpos: np.ndarray
    """Positions of the motors' joints in `qpos`."""
    motor_qvel: np.ndarray
    """Velocities of the motors' joints in `qvel`."""
    joint_qpos: np.ndarray
    """Positions of the joints with encoders in `qpos`."""
    joint_qvel: np.ndarray
    """Velocities of the joints with encoders in `qvel`."""
    pelvis_position: slice
    """Position of the pelvis in `qpos` [m, world]."""
    pelvis_orientation: slice
    """Orientation of the pelvis in `qpos` (pelvis to world, wxyz)."""
    pelvis_velocity: slice
    """Velocity of the pelvis in `qvel` [m/s, world]."""
    pelvis_angular_velocity: slice
    """Angular velocity of the pelvis in `qvel` [rad/s, pelvis]."""
    quaternions: tuple[slice, ...]
    """All unit quaternions in `qpos`, the pelvis' first."""
    foot_site: np.ndarray
    """(2,) ids of the sites at the sole centres."""
    ground_force: np.ndarray
    """(2, 3) ground reaction of each foot in `sensordata`, world frame."""
    foot_velocity: np.ndarray
    """(2, 3) velocity of each sole centre in `sensordata`, world frame."""
    pelvis_body: int
    """Id of the pelvis body."""

    @classmethod
    def of(cls, robot: Robot) -> Indices:
        """Indices of a robot's names."""
        skeleton = robot.skeleton
        joints, root = skeleton.joints, skeleton.joints[robot.pelvis]
        balls = [joint.qpos for joint in joints.values() if joint.kind == "ball"]
        starts = [root.qpos + 3, *sorted(balls)]
        return cls(
            num_qpos=skeleton.num_qpos,
            num_qvel=skeleton.num_qvel,
            motor_qpos=_read_only([joints[name].qpos for name in robot.motor_names]),
            motor_qvel=_read_only([joints[name].qvel for name in robot.motor_names]),
            joint_qpos=_read_only([joints[name].qpos for name in robot.joint_names]),
            joint_qvel=_read_only([joints[name].qvel for name in robot.joint_names]),
            pelvis_position=slice(root.qpos, root.qpos + 3),
            pelvis_orientation=slice(root.qpos + 3, root.qpos + 7),
            pelvis_velocity=slice(root.qvel, root.qvel + 3),
            pelvis_angular_velocity=slice(root.qvel + 3, root.qvel + 6),
            quaternions=tuple(slice(start, start + 4) for start in starts),
            foot_site=_read_only([skeleton.sites[name].index for name in robot.foot_sites]),
            ground_force=_sensors(skeleton, "ground_force"),
            foot_velocity=_sensors(skeleton, "foot_velocity"),
            pelvis_body=skeleton.bodies[robot.pelvis].index,
        )


def _sensors(skeleton: Skeleton, kind: str) -> np.ndarray:
    """(2, k) places of both sides' sensors of a kind."""
    sensors = [skeleton.sensors[f"{side}_{kind}"] for side in SIDES]
    return _read_only([np.arange(start, start + size) for start, size in sensors])


def _read_only(values: object) -> np.ndarray:
    array = np.array(values)
    array.setflags(write=False)
    return array
