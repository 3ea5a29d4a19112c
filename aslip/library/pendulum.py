r"""Walking of the linear inverted pendulum, in closed form: reference of baseline and ablation.

The body keeps its height z and follows, from each stance foot, the orbit of
:math:`\ddot x = \omega^2 x` with :math:`\omega = \sqrt{g / z}` (Kajita et al. 2001) that repeats
itself, mirrored, step after step:

.. math::
    x(t) = \tfrac{L}{2}\,\frac{\sinh \omega (t - T/2)}{\sinh \omega T/2}, \qquad
    y(t) = -\tfrac{w}{2}\,\frac{\cosh \omega (t - T/2)}{\cosh \omega T/2}

for a step of length L, width w and duration T; y is away from a left stance foot to the right. The
force on the ground then has a single, flat hump a stance. Swing feet move as those of the library's
gaits, and wait on the ground before they take over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aslip.errors import ConfigurationError
from aslip.ik import BodyTarget, Kinematics, solve, static_torque
from aslip.library.build import PAPER_SPEEDS, PHASE_SAMPLES
from aslip.library.file import GaitTable
from aslip.library.library import GaitLibrary
from aslip.robot import STANDARD_GRAVITY
from aslip.rom import Gait, SlipParameters, swing_foot

_MODEL = SlipParameters()


@dataclass(frozen=True)
class PendulumWalk:
    """A walk of the linear inverted pendulum.

    Mass, width and clearance are by default those of the actuated spring-mass model, so that the
    two differ in nothing but how the body moves over its feet.
    """

    speed: float = 0.75
    """Mean forward speed [m/s]; as the motion that the single-reference method was published
    with."""
    stride: float = 0.84
    """Duration of a stride, two steps [s]."""
    height: float = 0.92
    """Of the body, constant [m]; with it, the legs are a little bent as they pass."""
    width: float = _MODEL.foot_separation
    """Sideways distance of the feet [m]."""
    clearance: float = _MODEL.swing_clearance
    """Height of a foot in the middle of its swing [m]."""
    mass: float = _MODEL.mass
    """Mass of the body [kg]; joint torques carry its weight."""
    swing_share: float = 0.8
    """Share of a step that the foot is in the air."""

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            ConfigurationError: a length, time or mass is not positive, or the share not within
                (0, 1].
        """
        for name in ("stride", "height", "width", "clearance", "mass"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)!r}")
        if not 0 < self.swing_share <= 1:
            raise ConfigurationError(f"swing_share must be in (0, 1], got {self.swing_share!r}")
        if not np.isfinite(self.speed):
            raise ConfigurationError(f"speed must be finite [m/s], got {self.speed!r}")


SINGLE_REFERENCE_WALK: Final = PendulumWalk(clearance=0.15)
"""The one motion of the baseline. Its feet rise less than the model's: with this clearance the
shipped policy `single_reference` was trained."""


@dataclass(frozen=True, eq=False)
class PendulumMotion:
    """The walk at m phases from left lift-off, world frame; the stride begins at x = 0."""

    body: np.ndarray
    """(m, 3) [m]."""
    body_velocity: np.ndarray
    """(m, 3) [m/s]."""
    foot: np.ndarray
    """(2, m, 3) left and right [m]."""
    foot_velocity: np.ndarray
    """(2, m, 3) [m/s]."""
    ground_force: np.ndarray
    """(2, m, 3) on the feet of a body of the walk's mass [N]. While both feet stand, the one
    that came down bears nothing yet."""


def pendulum_motion(walk: PendulumWalk, phase: np.ndarray) -> PendulumMotion:
    """Body and feet at phases (m,) in [0, 1); the left foot swings in the first half."""
    duration, length = walk.stride / 2, walk.speed * walk.stride / 2
    second = phase >= 0.5
    time = (phase - 0.5 * second) * walk.stride
    omega = np.sqrt(STANDARD_GRAVITY / walk.height)
    angle, end = omega * (time - duration / 2), omega * duration / 2
    # the right foot, at -y, carries first
    side = np.where(second, -1.0, 1.0)
    start = np.where(second, length, 0.0)
    flat = np.zeros_like(time)
    body = np.stack(
        [
            start + length / 2 * (1 + np.sinh(angle) / np.sinh(end)),
            side * walk.width / 2 * (np.cosh(angle) / np.cosh(end) - 1),
            flat + walk.height,
        ],
        axis=1,
    )
    velocity = omega * np.stack(
        [
            length / 2 * np.cosh(angle) / np.sinh(end),
            side * walk.width / 2 * np.sinh(angle) / np.cosh(end),
            flat,
        ],
        axis=1,
    )
    feet, rates = [], []
    for i, begins in enumerate((0.0, 0.5)):
        y = (0.5 - i) * walk.width
        # a foot stands one half step before and behind the middle of its stances
        first = np.array([(2 * begins - 0.5) * length, y, 0.0])
        swing = walk.swing_share * duration
        fraction = (phase - begins) * walk.stride / swing
        position, rate, _ = swing_foot(
            fraction, first, first + np.array([2 * length, 0, 0]), walk.clearance, swing
        )
        feet.append(position)
        rates.append(rate)
    carrying = np.stack([second, ~second])[..., None]
    force = walk.mass * omega**2 * (body - np.stack(feet)) * carrying
    return PendulumMotion(body, velocity, np.stack(feet), np.stack(rates), force)


def pendulum_library(
    gaits: Sequence[Gait], walk: PendulumWalk | None = None, *, samples: int = PHASE_SAMPLES
) -> GaitLibrary:
    """A library of pendulum walks in place of optimal gaits, of the same speeds and strides.

    Each keeps the height that the body of the gait whose place it takes has in the middle of a
    stance, so that a foot in mid-swing is as far below the body as the gait's. At the gait's mean
    height the robot's legs are too long for the model's clearance from 1.8 m/s on.

    Args:
        gaits: in order of speed.
        walk: mass, width, clearance and share of swing of all of them; by default mass, width and
            clearance are those of the model that a gait is of.
        samples: of a stride.

    Raises:
        UnreachablePoseError: the robot cannot take a pose of a walk.
    """
    walks = []
    for gait in gaits:
        p = gait.parameters
        same = walk or PendulumWalk(
            width=p.foot_separation, clearance=p.swing_clearance, mass=p.mass
        )
        height = float(gait.body_position[:, 2].max())
        walks.append(replace(same, speed=gait.speed, stride=gait.stride, height=height))
    return GaitLibrary((), GaitTable(**_columns(walks, samples)), torque_jumps=True)


def single_reference_library(
    walk: PendulumWalk | None = None,
    *,
    top_speed: float = PAPER_SPEEDS[-1],
    samples: int = PHASE_SAMPLES,
) -> GaitLibrary:
    """One walk for all speeds: only the forward motion of the pelvis is stretched by the command.

    Joint angles stay those of the one walk (Xie et al. 2018). Between the two rows of this library,
    at rest and at the top speed, everything is linear in speed, so that every speed is covered.

    Args:
        walk: the one motion, `SINGLE_REFERENCE_WALK` by default.
        top_speed: of the library [m/s].
        samples: of a stride.

    Raises:
        ConfigurationError: the walk does not go forward.
        UnreachablePoseError: the robot cannot take a pose of the walk.
    """
    walk = walk or SINGLE_REFERENCE_WALK
    if walk.speed <= 0:
        raise ConfigurationError(f"a walk to be stretched must go forward, got {walk.speed} m/s")
    columns = _columns([walk, walk], samples)
    columns["speeds"] = np.array([0.0, top_speed])
    stretch = columns["speeds"] / walk.speed
    for name in ("body_position", "body_velocity", "qpos", "qvel"):
        columns[name][..., 0] *= stretch[:, None]
    return GaitLibrary((), GaitTable(**columns), torque_jumps=True)


def _columns(walks: Sequence[PendulumWalk], samples: int) -> dict[str, np.ndarray]:
    """Columns of a `GaitTable`, a row a walk."""
    phase = np.arange(samples) / samples
    motions = [pendulum_motion(walk, phase) for walk in walks]
    kinematics = Kinematics()
    poses = [
        solve(
            kinematics,
            BodyTarget(motion.body, velocity=motion.body_velocity),
            *(
                BodyTarget(foot, velocity=rate)
                for foot, rate in zip(motion.foot, motion.foot_velocity, strict=True)
            ),
        )
        for motion in motions
    ]
    torques = [
        static_torque(kinematics, pose.qpos, motion.ground_force.swapaxes(0, 1))
        for pose, motion in zip(poses, motions, strict=True)
    ]
    forward = np.stack(
        [np.outer(phase * walk.stride * walk.speed, [1.0, 0.0, 0.0]) for walk in walks]
    )
    body = np.stack([motion.body for motion in motions])
    qpos = np.stack([pose.qpos for pose in poses])
    qpos[..., :3] -= forward
    feet = {
        f"{side}_foot_{name}": np.stack([values(motion)[i] for motion in motions])
        for i, side in enumerate(("left", "right"))
        for name, values in (
            ("position", lambda m: m.foot - m.body),
            ("velocity", lambda m: m.foot_velocity),
        )
    }
    return {
        "speeds": np.array([walk.speed for walk in walks]),
        "strides": np.array([walk.stride for walk in walks]),
        "body_position": body - forward,
        "body_velocity": np.stack([motion.body_velocity for motion in motions]),
        "motor_position": np.stack([pose.motor_position for pose in poses]),
        "motor_velocity": np.stack([pose.motor_velocity for pose in poses]),
        "motor_torque": np.stack(torques),
        "qpos": qpos,
        "qvel": np.stack([pose.qvel for pose in poses]),
        **feet,
    }
