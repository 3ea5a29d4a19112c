r"""Optimal control problem: half a stride of the most economical walking at one mean speed.

Time 0 is left lift-off. Half a stride is right single stance, then double stance with the left foot
ahead; the other half is its mirror image. Only the speed varies between gaits, so the problem is
written and differentiated once and solved for one speed after another.

Paper says direct collocation over a given contact sequence, analytical gradients, IPOPT; we do the
same. Left and right of its published gaits differ by 0.1 mm; ours are exact mirror images. The
paper does not name its collocation rule; ours is Hermite-Simpson, with which an adaptive
integration of a contact mode ends within a micrometre of the collocated state.
"""

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from aslip.rom import collocation
from aslip.rom.assemble import POINTS, assemble, check_points, cost_of
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import CONTROL_SIZE, STATE_SIZE, flow_function, leg_function
from aslip.rom.gait import Gait
from aslip.rom.program import INTERVALS, GaitProgram, ModeSolution, effort
from aslip.rom.slip import Mode, Objective, SlipParameters

MIRROR = np.array([0, 1, 2, 3, 4, 5, 7, 6, 9, 8])
"""Order of the state with left and right exchanged."""
MIRROR_SIGN = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
"""Sign of the state with left and right exchanged: y and its rate change sign."""


@dataclass(frozen=True)
class HalfStride:
    """Half a stride at the collocation points: right single stance, then double stance.

    Single stance ends at the instant at which double stance begins. The state has one column for
    it; the input, which may jump there, has two.
    """

    state: np.ndarray
    """(10, 4 N + 1) states, N intervals per mode."""
    single_control: np.ndarray
    """(2, 2 N + 1) inputs in single stance [m/s^2]."""
    double_control: np.ndarray
    """(2, 2 N + 1) inputs in double stance [m/s^2]."""
    double_stance: float
    """Duration of double stance [s]."""
    right_foothold: float
    """x of the right foot [m], relative to the body at left lift-off."""


class HalfStrideProblem(GaitProgram[HalfStride]):
    """Nonlinear program of half a stride; its command is the speed alone."""

    _variables = HalfStride

    def _formulate(self) -> None:
        p, opti, points = self.parameters, self.opti, 2 * INTERVALS + 1

        # variables ------------------------------------------------------------------------------
        self.command = opti.parameter()
        self.state = state = opti.variable(STATE_SIZE, 2 * points - 1)
        self.single_control = opti.variable(CONTROL_SIZE, points)
        self.double_control = opti.variable(CONTROL_SIZE, points)
        self.double_stance = opti.variable()
        self.right_foothold = opti.variable()

        half_period = p.single_stance + self.double_stance
        step = self.command * half_period
        left = ca.vertcat(self.right_foothold + step, p.foot_separation / 2, 0)
        right = ca.vertcat(self.right_foothold, -p.foot_separation / 2, 0)
        single, double = state[:, :points], state[:, points - 1 :]

        # objective ------------------------------------------------------------------------------
        integral = p.single_stance / INTERVALS * effort(self.single_control)
        integral += self.double_stance / INTERVALS * effort(self.double_control)
        opti.minimize(integral / half_period if self.objective == "mean" else 2 * integral)

        # dynamics -------------------------------------------------------------------------------
        for name, mode, x, u, duration in (
            ("single stance defect", Mode.RIGHT, single, self.single_control, p.single_stance),
            ("double stance defect", Mode.DOUBLE, double, self.double_control, self.double_stance),
        ):
            derivative = flow_function(mode, p)(x, u, left, right)
            gaps = collocation.defects(x, derivative, duration / INTERVALS)
            self._require(name, ca.vec(gaps), ca.vec(gaps) == 0)

        # path constraints -----------------------------------------------------------------------
        # the last point is the mirror image of the first, where the bounds hold already
        force, length = leg_function(p)(state, left, right)
        landing, standing = force[0, points - 1 : -1] / p.weight, force[1, :-1] / p.weight
        landed_length, standing_length = length[0, points - 1 : -1], length[1, :-1]
        height = state[2, :-1]
        self._require("leg force, landing leg", landing, landing >= 0)
        # the other leg carries nothing in single stance
        least = np.repeat([[p.min_stance_force, 0.0]], points - 1, axis=1)
        self._require("leg force, standing leg", standing, standing >= least)
        for name, value in (("landing leg", landed_length), ("standing leg", standing_length)):
            bounded = opti.bounded(p.min_leg_length, value, p.max_leg_length)
            self._require(f"leg length, {name}", value, bounded)
        self._require("body height", height, height >= p.min_body_height)
        set_point = double[6, :]
        self._require("set point, landing leg", set_point, set_point <= p.max_set_point)
        double_stance = opti.bounded(p.min_double_stance, self.double_stance, p.max_double_stance)
        self._require("double stance", self.double_stance, double_stance)

        # boundary conditions --------------------------------------------------------------------
        # the spring of the landing leg is slack; the standing leg stops pushing
        slack = double[6, 0] - length[0, points - 1]
        self._require("touchdown", slack, slack == 0)
        self._require("lift-off", force[1, -1], force[1, -1] / p.weight == 0)
        # mean speed, and the mirror image of the first state as the last one
        travel = ca.DM.zeros(STATE_SIZE, 1) + ca.vertcat(step, ca.MX.zeros(STATE_SIZE - 1, 1))
        gap = state[:, -1] - travel - MIRROR_SIGN * state[MIRROR.tolist(), 0]
        self._require("periodicity and mean speed", gap, gap == 0)
        self._require("origin", state[0, 0], state[0, 0] == 0)

    def modes(self, solution: HalfStride, command: np.ndarray) -> list[ModeSolution]:
        """Right single stance and double stance."""
        p, touchdown = self.parameters, 2 * INTERVALS
        step = float(command[0]) * (p.single_stance + solution.double_stance)
        left = np.array([solution.right_foothold + step, p.foot_separation / 2, 0.0])
        right = np.array([solution.right_foothold, -p.foot_separation / 2, 0.0])
        single, double = solution.state[:, : touchdown + 1], solution.state[:, touchdown:]
        return [
            ModeSolution(mode, state, control, (left, right), duration)
            for mode, state, control, duration in (
                (Mode.RIGHT, single, solution.single_control, p.single_stance),
                (Mode.DOUBLE, double, solution.double_control, solution.double_stance),
            )
        ]

    def rough_guess(self, speed: float) -> HalfStride:
        """Initial guess: a sine-like vault at constant speed, sufficient from 0 to 2 m/s."""
        p, points = self.parameters, 2 * INTERVALS + 1
        double_stance = 0.1
        stance = np.linspace(0.0, p.single_stance, points)
        time = np.r_[stance, p.single_stance + np.linspace(0, double_stance, points)[1:]]
        state = np.zeros((STATE_SIZE, len(time)))
        state[0], state[3] = speed * time, speed
        # heights, set points and effort of the middle of the published library
        state[2] = 0.83 + 0.07 * np.sin(np.pi * np.minimum(time / p.single_stance, 1.0))
        state[6:8] = 0.92
        control = np.full((CONTROL_SIZE, points), 15.0)
        return HalfStride(state, control, control, double_stance, speed * p.single_stance / 2)


@lru_cache(maxsize=4)
def half_stride_problem(
    parameters: SlipParameters, objective: Objective = "mean"
) -> HalfStrideProblem:
    """Problem for given parameters, built on first use."""
    return HalfStrideProblem(parameters, objective)


def unfold(
    half: HalfStride, command: np.ndarray, certificate: Certificate, p: SlipParameters
) -> Gait:
    """Gait of half a stride (right single stance, double stance) and its mirror image."""
    step = float(command[0]) * (p.single_stance + half.double_stance)
    state = half.state[:, :-1]
    state = np.hstack([state, mirrored(state, step), half.state[:, :1]])
    state[0, -1] += 2 * step
    first = (half.single_control, half.double_control)
    durations = (p.single_stance, half.double_stance)
    cost = sum(cost_of(u, d) for u, d in zip(first, durations, strict=True))
    return assemble(
        command=command,
        double_stance=half.double_stance,
        state=state,
        controls=[*first, *(u[::-1] for u in first)],
        footholds=_footholds(half.right_foothold, step, p),
        cost=float(2 * cost),
        certificate=certificate,
        parameters=p,
    )


def fold(gait: Gait) -> HalfStride:
    """First half of a gait, an initial guess for the optimiser.

    Raises:
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    half = slice(0, 2 * POINTS + 1)
    state = np.hstack(
        [gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity]
    )
    return HalfStride(
        state=state[half].T,
        single_control=gait.control[: POINTS + 1].T,
        double_control=gait.control[POINTS : 2 * POINTS + 1].T,
        double_stance=gait.double_stance,
        right_foothold=float(gait.feet.position[0, 1, 0]),
    )


def mirrored(state: np.ndarray, step: float) -> np.ndarray:
    """Mirror states (10, n): left and right exchanged, one footstep ahead."""
    image = MIRROR_SIGN[:, None] * state[MIRROR]
    image[0] += step
    return image


def _footholds(right: float, step: float, p: SlipParameters) -> np.ndarray:
    """(2, 2, 3) start and end of the left and of the right swing [m]."""
    left, side, stride = right + step, p.foot_separation / 2, 2 * step
    return np.array(
        [
            [[left - stride, side, 0.0], [left, side, 0.0]],
            [[right, -side, 0.0], [right + stride, -side, 0.0]],
        ]
    )
