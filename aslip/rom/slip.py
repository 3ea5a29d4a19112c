"""Actuated spring-loaded inverted pendulum: parameters, contact modes, force of a leg."""

import math
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Final, Literal

import numpy as np

from aslip.base.checks import TINY, check_number
from aslip.errors import ConfigurationError
from aslip.rom.motion import Track

Objective = Literal["mean", "integral"]
"""Minimised quantity: the mean of u_l^2 + u_r^2 over the stride, or its integral."""


class Mode(IntEnum):
    """Contact mode: which feet are on the ground."""

    LEFT = 0
    RIGHT = 1
    DOUBLE = 2

    @property
    def stance(self) -> tuple[bool, bool]:
        """Contact of the left and of the right foot, True on the ground."""
        return self is not Mode.RIGHT, self is not Mode.LEFT


# limits of parameters that may be zero or are shares
_LIMITS = {
    "swing_ramp": (TINY, 0.5),
    "heel_offset": (0.0, math.inf),
    "min_stance_force": (0.0, 0.99),
}


@dataclass(frozen=True)
class SlipParameters:
    """Model of Green et al. 2021, Table I, and the bounds of the gait optimisation.

    The paper prints the five model numbers and the swing clearance. It mentions bounds without
    printing them; those marked "published gaits" were read from the gaits its authors released, and
    with them the optimiser returns those gaits to within 0.5 ms and 0.5 mm.

    Raises:
        ConfigurationError: a value is not positive and finite, the least stance force is not in
            [0, 1), the ramp of the swing is above 0.5, or a lower bound is not below its upper
            bound.
    """

    mass: float = 30.0
    """Body mass m [kg] (Table I)."""
    stiffness: float = 3000.0
    """Leg spring stiffness k [N/m] (Table I)."""
    damping: float = 2.0
    """Leg spring damping b [N s/m] (Table I)."""
    actuator_inertia: float = 10.0
    """Linear inertia I_m of a leg actuator [kg] (Table I)."""
    gravity: float = 9.81
    """Gravitational acceleration g [m/s^2] (Table I)."""

    single_stance: float = 0.300
    """Duration of a single stance [s] (published gaits: the same at every speed)."""
    min_double_stance: float = 0.050
    """Shortest double stance allowed [s]; inactive in every gait from 0 to 2 m/s."""
    max_double_stance: float = 0.200
    """Longest double stance allowed [s]; inactive in every gait from 0 to 2 m/s."""
    foot_separation: float = 0.200
    """Lateral distance between the footholds [m] (published gaits)."""
    min_foot_distance: float = 0.120
    """Least sideways distance between the feet, across the heading [m].

    Sidesteps need wider footholds to keep it; straight gaits never come near.
    """
    heel_offset: float = 0.0
    """Distance behind the centres of the feet at which the legs come closest in turns [m].

    There the toes point apart, so that legs which bend backward approach each other behind the
    feet. Footholds are wider where points at this distance behind the feet approach each other, as
    they are where the feet do. 0 for legs that end in their feet.
    """
    swing_clearance: float = 0.200
    """Height of the swing foot at half swing [m] (Sec. III-A)."""
    swing_ramp: float | None = None
    """Share of the swing, at most half, in which the foot speeds up, and of that in which it slows
    down; None for the profile of least jerk (Sec. III-A)."""

    max_set_point: float = 1.000
    """Largest set point of the landing leg, in double stance only [m] (published gaits).

    The paper speaks of bounds on leg extension. In the published gaits the set point stops at 1 m
    for the leg that has just landed, and only in double stance: the other leg exceeds 1 m by 9 mm
    at 2 m/s, and single stance by 1 mm at rest. A bound on both legs at all times would lower the
    highest body position by 1 mm at rest and by 5 mm at 2 m/s, so we keep theirs.
    """
    min_leg_length: float = 0.700
    """Shortest stance leg [m]; the paper gives no number and no gait comes within 0.1 m of it."""
    max_leg_length: float = 0.950
    """Longest stance leg [m] (published gaits)."""
    min_body_height: float = 0.800
    """Lowest body height [m] (published gaits: active from 1.6 m/s on)."""
    min_stance_force: float = 0.0
    """Least force of the leg in single stance, as a share of body weight.

    The published gaits have no such bound: up to 1.7 m/s the force vanishes in mid-stance, and a
    robot that follows them lets go of the floor.
    """
    max_speed: float = 2.4
    """Largest mean speed of a gait [m/s]; the paper's library ends at 2 m/s.

    From 2.5 m/s on no gait of this model satisfies the bounds above.
    """
    max_backward_speed: float = 1.2
    """Largest mean speed of a gait backward [m/s]."""
    max_sideways_speed: float = 0.6
    """Largest mean speed of a gait to either side [m/s]."""
    max_yaw_rate: float = 1.5
    """Largest mean yaw rate of a gait in either direction [rad/s]."""

    def __post_init__(self) -> None:
        """Check that values are positive and finite and bounds in order."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None or field.name != "swing_ramp":
                check_number(field.name, value, *_LIMITS.get(field.name, (TINY, math.inf)))
        for name in ("double_stance", "leg_length"):
            low, high = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if low >= high:
                raise ConfigurationError(f"min_{name} = {low} must be below max_{name} = {high}")

    @property
    def weight(self) -> float:
        """Body weight m g [N]."""
        return self.mass * self.gravity


DIRECTION_MODEL: Final = SlipParameters(
    min_stance_force=0.15, heel_offset=0.35, swing_clearance=0.12, swing_ramp=0.35
)
"""Model and bounds of gaits for Cassie in all directions: the standing foot keeps 15 % of body
weight, footholds of turns are wide enough for Cassie's legs, which reach 0.35 m behind the feet,
and the swing foot is low and steady, because Cassie's motors cannot follow the published swing at
2 m/s."""


def leg_forces(
    body: Track, feet: np.ndarray, set_point: Track, p: SlipParameters, stance: Any = True
) -> tuple[np.ndarray, np.ndarray]:
    """Axial forces (m, 2) of both legs, and forces (m, 2, 3) of the ground on the feet [N].

    Args:
        body: (m, 3) point mass.
        feet: (m, 2, 3) left and right foot, or (2, 3) for all m [m].
        set_point: (m, 2) actuator set points.
        p: model parameters.
        stance: (m, 2) bool, False for legs in swing, which have no force.
    """
    leg = body.position[:, None] - feet
    length = np.linalg.norm(leg, axis=2)
    length_rate = np.einsum("mlk,mk->ml", leg, body.velocity) / length
    force = leg_force(length, length_rate, set_point.position, set_point.velocity, p)
    force = np.where(stance, force, 0.0)
    return force, force[..., None] * leg / length[..., None]


def leg_force(
    length: Any, length_rate: Any, set_point: Any, set_point_rate: Any, p: SlipParameters
) -> Any:
    r"""Axial force of one leg [N], positive when it pushes the body away from the foot.

    .. math:: F = k\,(d - \ell) + b\,(\dot d - \dot\ell)

    Spring and damper of Green et al. 2021, Table I. Plain arithmetic: floats, NumPy arrays and
    CasADi expressions of equal shape are accepted.

    Args:
        length: leg length l, foot to body [m].
        length_rate: its rate [m/s].
        set_point: actuator set point d [m].
        set_point_rate: its rate [m/s].
        p: model parameters.

    Returns:
        Force in the shape of the inputs [N].
    """
    return p.stiffness * (set_point - length) + p.damping * (set_point_rate - length_rate)
