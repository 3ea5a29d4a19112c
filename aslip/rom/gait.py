"""A periodic walking gait of the actuated SLIP, sampled at the collocation points."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields

import numpy as np

from aslip.errors import FileDamagedError, ShapeError
from aslip.rom import collocation
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import Mode, leg_force
from aslip.rom.parameters import SlipParameters
from aslip.rom.swing import foot_motion

_COLUMNS = {
    "body_position": 3,
    "body_velocity": 3,
    "left_foot_position": 3,
    "left_foot_velocity": 3,
    "right_foot_position": 3,
    "right_foot_velocity": 3,
    "leg_force": 2,
    "set_point": 2,
    "set_point_velocity": 2,
    "control": 2,
}
_ARRAYS = ("time", "mode", *_COLUMNS)
_SCALARS = ("speed", "stride", "cost")


@dataclass(frozen=True, eq=False)
class GaitSample:
    """A gait at m given phases, world frame (x forward, y left, z up); see `Gait`."""

    phase: np.ndarray
    """(m,) stride fraction as asked for."""
    mode: np.ndarray
    """(m,) contact mode, values of `Mode`."""
    body_position: np.ndarray
    """(m, 3) [m]."""
    body_velocity: np.ndarray
    """(m, 3) [m/s], the exact time derivative of `body_position`."""
    left_foot_position: np.ndarray
    """(m, 3) [m]."""
    left_foot_velocity: np.ndarray
    """(m, 3) [m/s]."""
    right_foot_position: np.ndarray
    """(m, 3) [m]."""
    right_foot_velocity: np.ndarray
    """(m, 3) [m/s]."""
    leg_force: np.ndarray
    """(m, 2) axial force of the left and right leg [N], 0 in swing."""
    set_point: np.ndarray
    """(m, 2) [m]."""
    set_point_velocity: np.ndarray
    """(m, 2) [m/s]."""


@dataclass(frozen=True, eq=False)
class Gait:
    """One stride, from left lift-off (time 0) to the next left lift-off, both included.

    World frame: x forward, y left, z up, ground at z = 0. The body starts at x = 0 and its mean
    lateral position is 0. Positions along x grow over the stride. Times increase strictly; at the
    instant of a mode change, mode, force and control are those of the mode that begins. All arrays
    are read-only. The four modes of a stride are right, double, left, double.
    """

    speed: float
    """Mean forward speed [m/s]."""
    stride: float
    """Duration of the stride [s]."""
    time: np.ndarray
    """(n,) from 0 to `stride` [s]: nodes and midpoints of the collocation intervals."""
    mode: np.ndarray
    """(n,) contact mode, values of `Mode`."""
    body_position: np.ndarray
    """(n, 3) [m]."""
    body_velocity: np.ndarray
    """(n, 3) [m/s]."""
    left_foot_position: np.ndarray
    """(n, 3) [m]."""
    left_foot_velocity: np.ndarray
    """(n, 3) [m/s]."""
    right_foot_position: np.ndarray
    """(n, 3) [m]."""
    right_foot_velocity: np.ndarray
    """(n, 3) [m/s]."""
    leg_force: np.ndarray
    """(n, 2) axial force of the left and right leg [N], 0 in swing."""
    set_point: np.ndarray
    """(n, 2) actuator set points d [m]."""
    set_point_velocity: np.ndarray
    """(n, 2) [m/s]."""
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
        shapes: dict[str, tuple[int, ...]] = {"time": np.shape(self.time)}
        if len(shapes["time"]) != 1 or shapes["time"][0] < 2:
            raise ShapeError(f"time must be (n,) with n >= 2, got {shapes['time']}")
        count = shapes["time"][0]
        shapes |= {"mode": (count,)} | {name: (count, k) for name, k in _COLUMNS.items()}
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=int if name == "mode" else float)
            if array.shape != shape:
                raise ShapeError(f"{name} must have shape {shape}, got {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def single_stance(self) -> float:
        """Duration of one single stance [s]."""
        return self.parameters.single_stance

    @property
    def double_stance(self) -> float:
        """Duration of one double stance [s]."""
        return self.stride / 2 - self.single_stance

    @property
    def step_length(self) -> float:
        """Distance along x from one foothold to the next one, of the other foot [m]."""
        return self.speed * self.stride / 2

    @property
    def duty_factor(self) -> float:
        """Share of the stride for which a foot is on the ground."""
        return 1.0 - self.single_stance / self.stride

    def sample(self, phase: np.ndarray) -> GaitSample:
        """The gait at any phases.

        Body and set points are cubic Hermite interpolants through the collocation points and their
        velocities are the exact derivatives; swing feet are evaluated from their polynomials; leg
        forces follow from the interpolated state.

        Args:
            phase: (m,) stride fractions, 0 at left lift-off. A phase outside [0, 1) is another
                stride: x is moved by whole stride lengths.

        Returns:
            Arrays with leading dimension m.

        Raises:
            ShapeError: phase is not one-dimensional, or not finite.
        """
        phase = np.asarray(phase, dtype=float)
        if phase.ndim != 1 or not np.isfinite(phase).all():
            raise ShapeError(f"phase must be (m,) and finite, got shape {phase.shape}")
        strides = np.floor(phase)
        time = (phase - strides) * self.stride
        travelled = np.outer(strides, [self.speed * self.stride, 0.0, 0.0])
        # the last point is the first of the next stride, so the search stops short of it
        mode = self.mode[np.searchsorted(self.time[:-1], time, side="right") - 1]
        body, velocity = self._interpolate("body_position", "body_velocity", time)
        set_point, rate = self._interpolate("set_point", "set_point_velocity", time)
        left, left_velocity = self._foot(Mode.RIGHT, time)
        right, right_velocity = self._foot(Mode.LEFT, time)
        # (m, 2, 3): from each foot to the body
        leg = body[:, None, :] - np.stack([left, right], axis=1)
        length = np.linalg.norm(leg, axis=2)
        length_rate = np.einsum("mlk,mk->ml", leg, velocity) / length
        force = leg_force(length, length_rate, set_point, rate, self.parameters)
        in_swing = np.stack([mode == Mode.RIGHT, mode == Mode.LEFT], axis=1)
        return GaitSample(
            phase=phase,
            mode=mode,
            body_position=body + travelled,
            body_velocity=velocity,
            left_foot_position=left + travelled,
            left_foot_velocity=left_velocity,
            right_foot_position=right + travelled,
            right_foot_velocity=right_velocity,
            leg_force=np.where(in_swing, 0.0, force),
            set_point=set_point,
            set_point_velocity=rate,
        )

    def _interpolate(
        self, value: str, slope: str, time: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return collocation.hermite(self.time, getattr(self, value), getattr(self, slope), time)

    def _foot(self, swing: Mode, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity of the foot that swings in the given mode, each (m, 3)."""
        side = "left" if swing is Mode.RIGHT else "right"
        foothold = getattr(self, f"{side}_foot_position")
        lift_off = 0.0 if swing is Mode.RIGHT else self.stride / 2
        return foot_motion(time - lift_off, foothold[0], foothold[-1], self.parameters)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """All fields as arrays that `numpy.savez` stores without pickle.

        Scalars become zero-dimensional; certificate and parameters become strings of JSON.
        """
        plain = {name: np.array(getattr(self, name)) for name in (*_SCALARS, *_ARRAYS)}
        plain["certificate"] = np.array(self.certificate.to_json())
        plain["parameters"] = np.array(json.dumps(asdict(self.parameters)))
        return plain

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Gait":
        """Gait from what `to_arrays` returned, bit for bit.

        Raises:
            FileDamagedError: a field is missing, or certificate or parameters cannot be read.
            ShapeError: an array has the wrong shape.
        """
        missing = [f.name for f in fields(cls) if f.name not in arrays]
        if missing:
            raise FileDamagedError(f"a gait needs {', '.join(missing)}; got {sorted(arrays)}")
        try:
            certificate = Certificate.from_json(str(arrays["certificate"]))
            parameters = SlipParameters(**json.loads(str(arrays["parameters"])))
        except (ValueError, TypeError) as error:
            raise FileDamagedError(f"certificate or parameters unreadable: {error}") from error
        return cls(
            speed=float(arrays["speed"]),
            stride=float(arrays["stride"]),
            cost=float(arrays["cost"]),
            **{name: arrays[name] for name in _ARRAYS},
            certificate=certificate,
            parameters=parameters,
        )
