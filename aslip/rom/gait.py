"""Periodic walking gait of the actuated SLIP, sampled at the collocation points."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from aslip.errors import FileDamagedError, ShapeError
from aslip.rom.arc import twist_pose
from aslip.rom.certificate import Certificate
from aslip.rom.motion import Angle, MotionSample, Track, displacement, split_phase
from aslip.rom.slip import Mode, SlipParameters, leg_forces
from aslip.rom.swing import swing_foot, travel

_TRACKS = {"body": ("body_position", "body_velocity"), "feet": ("foot_position", "foot_velocity")}
"""Track of a gait -> names of its arrays in a file."""
_COLUMNS = ("leg_force", "set_point", "set_point_velocity", "control")
_SCALARS = ("stride", "cost")


@dataclass(frozen=True, eq=False, kw_only=True)
class GaitSample(MotionSample):
    """Gait sampled at m phases, with the state of its legs."""

    mode: np.ndarray
    """(m,) contact mode, values of `Mode`."""
    leg_force: np.ndarray
    """(m, 2) axial force of the left and right leg [N], 0 in swing."""
    set_point: np.ndarray
    """(m, 2) actuator set points d [m]."""
    set_point_velocity: np.ndarray
    """(m, 2) rates of the set points [m/s]."""


@dataclass(frozen=True, eq=False)
class Gait:
    """One stride, from left lift-off (time 0) to the next left lift-off, both included.

    Frame: heading at time 0; x forward, y left, z up, ground at z = 0. Body and feet advance over
    the stride. With one speed, the body starts at x = 0 and its mean lateral position is 0; with
    three commands its mean position is on the arc of the commands. Times increase strictly; at the
    instant of a mode change, mode, force and control are those of the mode that begins. All arrays
    are read-only. The four modes of a stride are right, double, left, double.

    Raises:
        ShapeError: an array has the wrong shape.
    """

    command: np.ndarray
    """(1,) mean forward speed [m/s], or (3,) with sideways speed [m/s] and yaw rate [rad/s]."""
    stride: float
    """Duration of the stride [s]."""
    time: np.ndarray
    """(n,) from 0 to `stride` [s]: nodes and midpoints of the collocation intervals."""
    mode: np.ndarray
    """(n,) contact mode, values of `Mode`."""
    body: Track
    """(n, 3) point mass."""
    feet: Track
    """(n, 2, 3) left and right foot."""
    leg_force: np.ndarray
    """(n, 2) axial force of the left and right leg [N], 0 in swing."""
    set_point: np.ndarray
    """(n, 2) actuator set points d [m]."""
    set_point_velocity: np.ndarray
    """(n, 2) rates of the set points [m/s]."""
    control: np.ndarray
    """(n, 2) actuator accelerations u [m/s^2]."""
    cost: float
    """Integral of u_l^2 + u_r^2 over the stride [m^2/s^3], the objective as the paper prints it."""
    certificate: Certificate
    """Evidence of optimality and feasibility."""
    parameters: SlipParameters = field(default_factory=SlipParameters)
    """Model and bounds of the gait."""

    def __post_init__(self) -> None:
        """Check shapes and make the arrays read-only."""
        shape = np.shape(self.time)
        if len(shape) != 1 or shape[0] < 2:
            raise ShapeError(f"time must be (n,) with n >= 2, got {shape}")
        (n,) = shape
        command = np.array(self.command, dtype=float)
        if command.shape not in ((1,), (3,)):
            raise ShapeError(f"command must have shape (1,) or (3,), got {command.shape}")
        arrays = {"time": _frozen("time", self.time, (n,))}
        arrays["command"] = _frozen("command", command, command.shape)
        arrays["mode"] = _frozen("mode", self.mode, (n,), int)
        arrays |= {name: _frozen(name, getattr(self, name), (n, 2)) for name in _COLUMNS}
        body = _frozen_track("body", self.body, (n, 3))
        feet = _frozen_track("feet", self.feet, (n, 2, 3))
        for name, value in {**arrays, "body": body, "feet": feet}.items():
            object.__setattr__(self, name, value)

    @property
    def speed(self) -> float:
        """Mean forward speed [m/s]."""
        return float(self.command[0])

    @property
    def yaw_rate(self) -> float:
        """Mean yaw rate [rad/s]."""
        return float(self.command[2]) if len(self.command) == 3 else 0.0

    @property
    def single_stance(self) -> float:
        """Duration of one single stance [s]."""
        return self.parameters.single_stance

    @property
    def double_stance(self) -> float:
        """Duration of each double stance [s]."""
        return self.stride / 2 - self.single_stance

    @property
    def step_length(self) -> float:
        """Mean forward distance of the body per footstep [m]."""
        return self.speed * self.stride / 2

    @property
    def step_width(self) -> float:
        """Sideways distance between the footholds, each in the heading frame of its mid-stance [m].

        It is negative if the feet cross.
        """
        ground = np.stack([self.feet.position[-1, 0], self.feet.position[0, 1]])
        mid_stance = (self.single_stance + np.array([self.stride, 0.0])) / 2
        left, right = twist_pose(self.command, mid_stance).inverse().transform(ground)
        return float(left[1] - right[1])

    @property
    def duty_factor(self) -> float:
        """Share of the stride for which a foot is on the ground."""
        return 1.0 - self.single_stance / self.stride

    def sample(self, phase: np.ndarray) -> GaitSample:
        """Sample the gait at any phases.

        Body and set points are cubic Hermite interpolants through the collocation points and their
        velocities are the exact derivatives; swing feet are evaluated from their polynomials; leg
        forces follow from the interpolated state.

        Args:
            phase: (m,) stride fractions, 0 at left lift-off. Phases outside [0, 1) belong to
                earlier or later strides.

        Returns:
            Arrays with leading dimension m.

        Raises:
            ShapeError: phase is not one-dimensional, or not finite.
        """
        strides, within = split_phase(phase)
        time = within * self.stride
        # the last point opens the next stride and is left out of the search
        mode = self.mode[np.searchsorted(self.time[:-1], time, side="right") - 1]
        body = self.body.interpolated(self.time, time)
        set_point = Track(self.set_point, self.set_point_velocity).interpolated(self.time, time)
        footholds = np.stack([self.feet.position[0], self.feet.position[-1]], axis=1)
        turn, p = self.yaw_rate * self.stride, self.parameters
        feet = swinging_feet(time, self.stride, footholds, p, turn=turn)
        stance = np.stack([mode != Mode.RIGHT, mode != Mode.LEFT], axis=1)
        axial, force = leg_forces(body, feet.position, set_point, p, stance)
        sample = GaitSample(
            body=body,
            feet=feet,
            ground_force=force,
            heading=Angle(self.yaw_rate * time, np.full(len(time), self.yaw_rate)),
            foot_heading=_foot_heading(time, self.stride, turn, p),
            mode=mode,
            leg_force=axial,
            set_point=set_point.position,
            set_point_velocity=set_point.velocity,
        )
        return sample.moved(displacement(self, strides))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """All fields as arrays that `numpy.savez` stores without pickle.

        Scalars become zero-dimensional; certificate and parameters become strings of JSON.
        """
        named = ("command", *_SCALARS, "time", "mode", *_COLUMNS)
        plain = {name: np.array(getattr(self, name)) for name in named}
        for track, (position, velocity) in _TRACKS.items():
            plain[position] = np.array(getattr(self, track).position)
            plain[velocity] = np.array(getattr(self, track).velocity)
        plain["certificate"] = np.array(self.certificate.to_json())
        plain["parameters"] = np.array(json.dumps(asdict(self.parameters)))
        return plain

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Gait":
        """Gait from the arrays of `to_arrays`, bit for bit.

        Raises:
            FileDamagedError: a field is missing, or certificate or parameters cannot be read.
            ShapeError: an array has the wrong shape.
        """
        columns = ("command", "time", "mode", *_COLUMNS)
        try:
            return cls(
                stride=float(arrays["stride"]),
                cost=float(arrays["cost"]),
                **{name: arrays[name] for name in columns},
                body=Track(*(arrays[name] for name in _TRACKS["body"])),
                feet=Track(*(arrays[name] for name in _TRACKS["feet"])),
                certificate=Certificate.from_json(str(arrays["certificate"])),
                parameters=SlipParameters(**json.loads(str(arrays["parameters"]))),
            )
        except KeyError as error:
            raise FileDamagedError(f"a gait needs {error}; got {sorted(arrays)}") from error
        except (json.JSONDecodeError, TypeError) as error:
            raise FileDamagedError(
                f"certificate or parameters of a gait are unreadable: {error}"
            ) from error


def swinging_feet(
    time: np.ndarray, stride: float, footholds: np.ndarray, p: SlipParameters, *, turn: float = 0.0
) -> Track:
    """Feet of a gait, (m, 2, 3): the left swings from time 0, the right half a stride later.

    Args:
        time: (m,) since left lift-off, at most a stride [s].
        stride: duration of a stride [s].
        footholds: (2, 2, 3) start and end of the left and of the right swing [m].
        p: model parameters, with duration and clearance of the swing.
        turn: angle by which a stride turns, and so the arc of each foot [rad].
    """
    feet = [
        swing_foot(
            time - lift_off,
            start,
            end,
            duration=p.single_stance,
            clearance=p.swing_clearance,
            ramp=p.swing_ramp,
            turn=turn,
        )
        for lift_off, (start, end) in zip((0.0, stride / 2), footholds, strict=True)
    ]
    return Track(
        np.stack([foot.position for foot in feet], axis=1),
        np.stack([foot.velocity for foot in feet], axis=1),
    )


def _foot_heading(time: np.ndarray, stride: float, turn: float, p: SlipParameters) -> np.ndarray:
    """Direction of the toes (m, 2) [rad]: the heading at mid-stance, turned in swing.

    Args:
        time: (m,) since left lift-off, at most a stride [s].
        stride: duration of a stride [s].
        turn: angle by which a stride turns [rad].
        p: model parameters, with the duration of the swing.
    """
    lift_off = np.array([0.0, stride / 2])
    mid_stance = lift_off + (p.single_stance - stride) / 2
    share = travel((time[:, None] - lift_off) / p.single_stance, ramp=p.swing_ramp)
    return turn * (mid_stance / stride + share)


def _frozen(
    name: str, value: np.ndarray, shape: tuple[int, ...], kind: type[int | float] = float
) -> np.ndarray:
    """Copy an array, check its shape and make it read-only."""
    array = np.array(value, dtype=kind)
    if array.shape != shape:
        raise ShapeError(f"{name} must have shape {shape}, got {array.shape}")
    array.setflags(write=False)
    return array


def _frozen_track(name: str, track: Track, shape: tuple[int, ...]) -> Track:
    return Track(
        _frozen(f"{name}.position", track.position, shape),
        _frozen(f"{name}.velocity", track.velocity, shape),
    )
