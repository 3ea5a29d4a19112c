r"""Optimal control problem: a whole stride of the most economical walking in any direction.

Time 0 is left lift-off. The modes of a stride are right single stance, double stance, left single
stance, double stance. The gait is a relative periodic orbit: after the stride the state is the
first one, turned by the yaw rate times the stride and moved along the arc of constant twist that
the command prescribes. Actuators repeat. Both double stances last equally long: otherwise the
optimum limps, even straight ahead, and its mirror image is as good.

The sideways distance s of left and right foothold is at least foot_separation. It is larger in
sidesteps and turns, in which the feet approach each other by a_i at the four lift-offs and
touchdowns, and points heel_offset behind them by b_i:

.. math:: s - d \ge \sqrt[4]{(s_0 - d)^4 + \tfrac14 \sum_i (a_i^4 + b_i^4)}

with s_0 the foot separation of a straight gait and d the least distance of the feet. In a sidestep,
and in a turn in place, the four approaches are nearly equal in size, and the right side is a smooth
maximum. A bound on the bare distance would give the gaits a kink over the command, and look-ups
errors there. The feet have that bound, too; it binds where the a_i differ, in walks that sidestep
into their turn.

All positions are in the heading frame of the stride's start; the moving frame leaves it at time 0
with the commanded twist. Each foothold is fixed in the moving frame of its own
mid-stance. The body's mean position in the moving frame is the origin, so that the body, rather
than a point beside it, obeys the command. Straight ahead the solution is that of
`aslip.rom.half_stride`, with both halves alike.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from aslip.rom import collocation
from aslip.rom.arc import twist_pose
from aslip.rom.assemble import MODES, POINTS, assemble, check_points, collocation_times, cost_of
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import CONTROL_SIZE, STATE_SIZE, flow_function, leg_function
from aslip.rom.gait import Gait
from aslip.rom.program import INTERVALS, GaitProgram, ModeSolution, effort
from aslip.rom.slip import Mode, Objective, SlipParameters
from aslip.rom.swing import travel

_NAMES = (
    "right single stance",
    "left leg lands",
    "left single stance",
    "right leg lands",
)
"""Names of the contact modes in constraints."""


@dataclass(frozen=True)
class WholeStride:
    """Stride at the collocation points; modes share the state at their common instant."""

    state: np.ndarray
    """(10, 8 N + 1) states, N intervals per mode."""
    control: np.ndarray
    """(2, 8 N + 4) inputs, 2 N + 1 columns per mode [m/s^2]."""
    double_stance: float
    """Duration of each double stance [s]."""
    foothold: np.ndarray
    """(2, 2) left and right foothold, forward and sideways, in the moving frames of their
    mid-stances [m]; column 0 is the left one."""


class StrideProblem(GaitProgram[WholeStride]):
    """Nonlinear program of a stride; its command is (forward, sideways speed, yaw rate)."""

    _variables = WholeStride

    def _formulate(self) -> None:
        p, opti = self.parameters, self.opti

        # variables ------------------------------------------------------------------------------
        self.command = opti.parameter(3)
        self.state = opti.variable(STATE_SIZE, 4 * POINTS + 1)
        self.control = opti.variable(CONTROL_SIZE, 4 * (POINTS + 1))
        self.double_stance = opti.variable()
        self.foothold = opti.variable(2, 2)

        begins, mid_stance = schedule(self.double_stance, p)
        stride = begins[4]
        durations = [end - begin for begin, end in pairwise(begins)]
        states = [self.state[:, POINTS * k : POINTS * (k + 1) + 1] for k in range(4)]
        controls = ca.horzsplit(self.control, POINTS + 1)

        # objective ------------------------------------------------------------------------------
        integral = sum(d / INTERVALS * effort(u) for d, u in zip(durations, controls, strict=True))
        opti.minimize(integral / stride if self.objective == "mean" else integral)

        # dynamics and path constraints ----------------------------------------------------------
        left, right, next_right = (
            self._foothold(foot, mid_stance[foot] + later)
            for foot, later in ((0, 0), (1, 0), (1, stride))
        )
        pairs = ((left, right), (left, right), (left, next_right), (left, next_right))
        for k, (mode, feet) in enumerate(zip(MODES, pairs, strict=True)):
            derivative = flow_function(mode, p)(states[k], controls[k], *feet)
            gaps = collocation.defects(states[k], derivative, durations[k] / INTERVALS)
            self._require(f"defect, {_NAMES[k]}", ca.vec(gaps), ca.vec(gaps) == 0)
        self._bound_legs(states, pairs)
        self._bound_feet(begins, mid_stance)

        # boundary conditions --------------------------------------------------------------------
        self._exchange_legs(states, pairs)
        self._repeat(stride)
        self._centre(begins, durations)

    def _bound_legs(self, states: list[ca.MX], pairs: tuple) -> None:
        """Bound forces, leg lengths, set points and body height."""
        p, opti = self.parameters, self.opti
        for k, (mode, feet) in enumerate(zip(MODES, pairs, strict=True)):
            # the last point is the first one of the next mode
            force, length = leg_function(p)(states[k][:, :-1], *feet)
            landing = {1: 0, 3: 1}.get(k)
            for leg in (leg for leg in range(2) if mode.stance[leg]):
                name = "landing leg" if leg == landing else "standing leg"
                least = 0.0 if mode is Mode.DOUBLE else p.min_stance_force
                share = force[leg, :] / p.weight
                self._require(f"leg force, {_NAMES[k]}, {name}", share, share >= least)
                bounded = opti.bounded(p.min_leg_length, length[leg, :], p.max_leg_length)
                self._require(f"leg length, {_NAMES[k]}, {name}", length[leg, :], bounded)
            if landing is not None:
                set_point = states[k][6 + landing, :]
                self._require(f"set point, {_NAMES[k]}", set_point, set_point <= p.max_set_point)
        height = self.state[2, :-1]
        self._require("body height", height, height >= p.min_body_height)

    def _bound_feet(self, begins: list[ca.MX], mid_stance: list[ca.MX]) -> None:
        """Bound double stances, the separation of the footholds, the distance of passing feet."""
        p, opti = self.parameters, self.opti
        double_stance = opti.bounded(p.min_double_stance, self.double_stance, p.max_double_stance)
        self._require("double stance", self.double_stance, double_stance)
        separation = self.foothold[1, 0] - self.foothold[1, 1]
        fraction = np.linspace(0.0, 1.0, POINTS + 1)
        share, approach = ca.DM(travel(fraction, ramp=p.swing_ramp)).T, []
        for k, swing in ((0, 0), (2, 1)):
            time = begins[k] + p.single_stance * ca.DM(fraction).T
            stance_time = mid_stance[1 - swing] - time
            swing_time = mid_stance[swing] - time + begins[4] * (share + k // 2 - 1)
            sides = [swing_time, stance_time] if swing == 0 else [stance_time, swing_time]
            feet, heels = (
                ca.vertcat(*(self._foothold(i, sides[i], behind)[1, :] for i in range(2)))
                for behind in (0.0, p.heel_offset)
            )
            distance = feet[0, :] - feet[1, :]
            side = ("left", "right")[swing]
            self._require(f"foot distance, {side} swing", distance, distance >= p.min_foot_distance)
            for across in (feet, heels):
                approach.append(separation - across[0, [0, -1]] + across[1, [0, -1]])
        # a smooth maximum: a kink in it would give the gaits a kink over the command
        room = p.foot_separation - p.min_foot_distance
        room = (room**4 + ca.sumsqr(ca.horzcat(*approach) ** 2) / 4) ** 0.25
        wide = separation - p.min_foot_distance - room
        self._require("foot separation", wide, wide >= 0)

    def _exchange_legs(self, states: list[ca.MX], pairs: tuple) -> None:
        """Land with a slack spring, leave without a force."""
        p = self.parameters
        for k, landing, name in ((1, 0, "left"), (3, 1, "right")):
            _, length = leg_function(p)(states[k][:, 0], *pairs[k])
            slack = states[k][6 + landing, 0] - length[landing]
            self._require(f"{name} touchdown", slack, slack == 0)
        for k, leaving, name in ((1, 1, "right"), (3, 0, "left")):
            force, _ = leg_function(p)(states[k][:, -1], *pairs[k])
            share = force[leaving] / p.weight
            self._require(f"{name} lift-off", share, share == 0)

    def _repeat(self, stride: ca.MX) -> None:
        """End with the first state, turned and moved on."""
        first, last = self.state[:, 0], self.state[:, -1]
        angle, shift = _arc(self.command, stride)
        position = shift + _rotate(angle, first[:2])
        velocity = _rotate(angle, first[3:5])
        image = ca.vertcat(position, first[2], velocity, first[5:])
        self._require("periodicity", last - image, last - image == 0)

    def _centre(self, begins: list[ca.MX], durations: list[ca.MX]) -> None:
        """Keep the body's mean position in the moving frame at the origin."""
        mean, weight = ca.MX.zeros(2), ca.DM(collocation.weights(INTERVALS)).T
        for k in range(4):
            time = begins[k] + durations[k] * ca.DM(np.linspace(0.0, 1.0, POINTS + 1)).T
            angle, shift = _arc(self.command, time)
            path = self.state[:2, POINTS * k : POINTS * (k + 1) + 1]
            deviation = _rotate(-angle, path - shift)
            mean += durations[k] / INTERVALS * ca.sum2(deviation * ca.repmat(weight, 2, 1))
        self._require("origin", mean, mean == 0)

    def _foothold(self, foot: int, time: ca.MX, behind: float = 0.0) -> ca.MX:
        """Foothold, or a point behind it [m], carried along by the moving frame.

        Points (3, n) at times (1, n) after the foot's mid-stance [s].
        """
        angle, shift = _arc(self.command, time)
        count = angle.shape[1]
        place = self.foothold[:, foot] - ca.DM([behind, 0.0])
        point = shift + _rotate(angle, ca.repmat(place, 1, count))
        return ca.vertcat(point, ca.MX.zeros(1, count))

    def modes(self, solution: WholeStride, command: np.ndarray) -> list[ModeSolution]:
        """Four contact modes."""
        begins, _ = schedule(solution.double_stance, self.parameters)
        (_, left), (right, next_right) = footholds(solution, command, self.parameters)
        pairs = ((left, right), (left, right), (left, next_right), (left, next_right))
        return [
            ModeSolution(
                mode,
                solution.state[:, POINTS * k : POINTS * (k + 1) + 1],
                solution.control[:, (POINTS + 1) * k : (POINTS + 1) * (k + 1)],
                pairs[k],
                begins[k + 1] - begins[k],
            )
            for k, mode in enumerate(MODES)
        ]

    def rough_guess(self, command: np.ndarray) -> WholeStride:
        """Initial guess: sine-like vaults at constant twist."""
        p = self.parameters
        double_stance = 0.1
        time = collocation_times(double_stance, p)
        pose = twist_pose(command, time)
        state = np.zeros((STATE_SIZE, len(time)))
        state[:3] = pose.position.T
        state[3:6] = pose.rotate(np.tile([command[0], command[1], 0.0], (len(time), 1))).T
        # heights and set points of the middle of the published library. With its effort as well,
        # slow gaits end in a costly local optimum whose double stances have their largest duration.
        step = np.minimum(time % (time[-1] / 2) / p.single_stance, 1.0)
        state[2] = 0.83 + 0.07 * np.sin(np.pi * step)
        state[6:8] = 0.92
        approach = (abs(command[1]) + p.heel_offset * abs(command[2])) * time[-1] / 2
        separation = max(p.foot_separation, p.min_foot_distance + approach)
        foothold = np.array([[0.0, 0.0], [separation / 2, -separation / 2]])
        control = np.zeros((CONTROL_SIZE, 4 * (POINTS + 1)))
        return WholeStride(state, control, double_stance, foothold)


def schedule(double_stance: Any, p: SlipParameters) -> tuple[list[Any], list[Any]]:
    """Instants [s] at which modes begin and the stride ends, and mid-stances of both feet."""
    single, step = p.single_stance, p.single_stance + double_stance
    return [0.0, single, step, step + single, 2 * step], [single / 2 + step, single / 2]


def footholds(solution: WholeStride, command: np.ndarray, p: SlipParameters) -> np.ndarray:
    """(2, 2, 3) start and end of the left and of the right swing [m]."""
    begins, (left, right) = schedule(solution.double_stance, p)
    times = np.array([left - begins[4], left, right, right + begins[4]])
    point = np.zeros((4, 3))
    point[:, :2] = solution.foothold.T[[0, 0, 1, 1]]
    return twist_pose(command, times).transform(point).reshape(2, 2, 3)


def _arc(command: ca.MX, time: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Angle (1, n) and path (2, n) of the moving frame at times (1, n), see `twist_pose`."""
    angle = command[2] * time
    shift = ca.repmat(command[:2], 1, ca.MX(angle).shape[1])
    return angle, _rotate(angle / 2, shift) * ca.repmat(_sinc(angle / 2) * time, 2, 1)


def _rotate(angle: ca.MX, vectors: ca.MX) -> ca.MX:
    """Vectors (2, n) turned by angles (1, n), or by one angle."""
    cosine, sine = ca.cos(angle), ca.sin(angle)
    x, y = vectors[0, :], vectors[1, :]
    return ca.vertcat(cosine * x - sine * y, sine * x + cosine * y)


def _sinc(x: ca.MX) -> ca.MX:
    """Unnormalised sine cardinal by its power series, exact to rounding up to |x| = 1.3."""
    terms = 9
    value = ca.MX(1.0)
    for k in range(terms, 0, -1):
        value = 1 - x**2 / (2 * k * (2 * k + 1)) * value
    return value


@lru_cache(maxsize=4)
def stride_problem(parameters: SlipParameters, objective: Objective = "mean") -> StrideProblem:
    """Problem for given parameters, built on first use."""
    return StrideProblem(parameters, objective)


def gait_of_stride(
    solution: WholeStride, command: np.ndarray, certificate: Certificate, p: SlipParameters
) -> Gait:
    """Gait of a solved stride."""
    controls = np.split(solution.control, 4, axis=1)
    durations = 2 * [p.single_stance, solution.double_stance]
    return assemble(
        command=command,
        double_stance=solution.double_stance,
        state=solution.state,
        controls=controls,
        footholds=footholds(solution, command, p),
        cost=float(sum(cost_of(u, d) for u, d in zip(controls, durations, strict=True))),
        certificate=certificate,
        parameters=p,
    )


def stride_of_gait(gait: Gait, command: np.ndarray) -> WholeStride:
    """Stride of a gait, carried over to the path of another command.

    Body and footholds keep their places in the moving frame; the body's velocity changes by the
    difference of the commands.

    Raises:
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    to_frame = twist_pose(gait.command, gait.time).inverse()
    from_frame = twist_pose(command, gait.time)
    faster = np.array([command[0], command[1], 0.0])
    faster[: min(len(gait.command), 2)] -= gait.command[:2]
    state = [
        from_frame.transform(to_frame.transform(gait.body.position)),
        from_frame.rotate(to_frame.rotate(gait.body.velocity) + faster),
        gait.set_point,
        gait.set_point_velocity,
    ]
    _, mid_stance = schedule(gait.double_stance, gait.parameters)
    ground = np.stack([gait.feet.position[-1, 0], gait.feet.position[0, 1]])
    foothold = twist_pose(gait.command, np.array(mid_stance)).inverse().transform(ground)
    controls = [gait.control[POINTS * k : POINTS * (k + 1) + 1] for k in range(4)]
    return WholeStride(
        state=np.hstack(state).T,
        control=np.vstack(controls).T,
        double_stance=gait.double_stance,
        foothold=foothold[:, :2].T,
    )
