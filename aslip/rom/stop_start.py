r"""Optimal control problem: from stepping in place to standing, and from standing to stepping.

Both feet stay on the ground. The stop begins at a touchdown of the gait in place, with all of its
state, and ends at rest in static equilibrium, the body halfway between the feet. The start leads
from that rest to the gait's next lift-off. Both durations and the height at rest are free; the
integral of the squared inputs over both is minimised. Holding the weight costs effort, too, so the
durations are finite.

The in-place gait stays in the plane of its feet, where no leg pushes forward or backward. So the
forward components of the last states are left free: they follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from aslip.errors import ConfigurationError
from aslip.rom import collocation
from aslip.rom.assemble import POINTS, check_points
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import CONTROL_SIZE, STATE_SIZE, flow_function, leg_function
from aslip.rom.gait import Gait
from aslip.rom.motion import Track
from aslip.rom.program import INTERVALS, GaitProgram, ModeSolution, effort
from aslip.rom.slip import Mode, SlipParameters
from aslip.rom.standing import Transition

MAX_DURATION = 1.0
"""Longest stop or start allowed [s]; inactive with Table I's model."""

_NAMES = ("stop", "start")
_LANDED = 0  # index of the leg that lands before the stop; the other one leaves after the start
CHANGING = {"stop": _LANDED, "start": 1 - _LANDED}
_VALUES, _RATES = [0, 1, 2, 6, 7], [3, 4, 5, 8, 9]  # rows of the state
_PLANE = [1, 2, 4, 5, 6, 7, 8, 9]  # state without its forward components


@dataclass(frozen=True)
class StopAndStart:
    """Stop and start at the collocation points."""

    stop_state: np.ndarray
    """(10, 2 N + 1) states from left touchdown to rest."""
    start_state: np.ndarray
    """(10, 2 N + 1) states from rest to right lift-off."""
    stop_control: np.ndarray
    """(2, 2 N + 1) inputs of the stop [m/s^2]."""
    start_control: np.ndarray
    """(2, 2 N + 1) inputs of the start [m/s^2]."""
    duration: np.ndarray
    """(2,) durations of stop and start [s]."""


class StopStartProblem(GaitProgram[StopAndStart]):
    """Nonlinear program of a stop and a start; its parameters are their ends in the gait.

    The parameters, in place of a command: state at left touchdown (10), state at right lift-off
    (10), left and right foot (3 + 3), see `aslip.rom.stop_start.ends_of_gait`.
    """

    _variables = StopAndStart

    def _formulate(self) -> None:
        opti = self.opti
        self.command = opti.parameter(2 * STATE_SIZE + 6)
        touchdown, lift_off, left, right = ca.vertsplit(self.command, [0, 10, 20, 23, 26])
        self.stop_state, self.start_state = (opti.variable(STATE_SIZE, POINTS + 1) for _ in _NAMES)
        self.stop_control, self.start_control = (
            opti.variable(CONTROL_SIZE, POINTS + 1) for _ in _NAMES
        )
        self.duration = opti.variable(2)

        states = (self.stop_state, self.start_state)
        controls = (self.stop_control, self.start_control)
        integrals = [
            self.duration[i] / INTERVALS * effort(control) for i, control in enumerate(controls)
        ]
        opti.minimize(sum(integrals))
        for i, name in enumerate(_NAMES):
            derivative = flow_function(Mode.DOUBLE, self.parameters)(
                states[i], controls[i], left, right
            )
            gaps = collocation.defects(states[i], derivative, self.duration[i] / INTERVALS)
            self._require(f"defect, {name}", ca.vec(gaps), ca.vec(gaps) == 0)
            self._bound(name, states[i], left, right)
            duration = opti.bounded(
                self.parameters.min_double_stance, self.duration[i], MAX_DURATION
            )
            self._require(f"duration, {name}", self.duration[i], duration)
        self._join(touchdown, lift_off, left, right)

    def _bound(self, name: str, state: ca.MX, left: ca.MX, right: ca.MX) -> None:
        """Bound forces, leg lengths, set points and body height; the gait bounds its own points."""
        p, opti = self.parameters, self.opti
        inner = state[:, 1:] if name == "stop" else state[:, 1:-1]
        force, length = leg_function(p)(inner, left, right)
        for leg, side in enumerate(("left", "right")):
            share = force[leg, :] / p.weight
            # the leg that lands or leaves has no force at that instant
            least = 0.0 if leg == CHANGING[name] else p.min_stance_force
            self._require(f"leg force, {name}, {side} leg", share, share >= least)
            bounded = opti.bounded(p.min_leg_length, length[leg, :], p.max_leg_length)
            self._require(f"leg length, {name}, {side} leg", length[leg, :], bounded)
        set_point = inner[6 + _LANDED, :]
        self._require(f"set point, {name}", set_point, set_point <= p.max_set_point)
        height = inner[2, :]
        self._require(f"body height, {name}", height, height >= p.min_body_height)

    def _join(self, touchdown: ca.MX, lift_off: ca.MX, left: ca.MX, right: ca.MX) -> None:
        """Begin and end in the gait, with rest in between."""
        p, rest = self.parameters, self.stop_state[:, -1]
        first, last = self.stop_state[:, 0] - touchdown, self.start_state[:, -1] - lift_off
        again = self.start_state[:, 0] - rest
        force, length = leg_function(p)(rest, left, right)
        carried = ca.sum1(force / length) * rest[2] / p.weight
        still = ca.vertcat(
            rest[1] - (left[1] + right[1]) / 2, rest[4:6], rest[6] - rest[7], rest[8:]
        )
        self._require("touchdown", first, first == 0)
        self._require("rest", still, still == 0)
        self._require("static equilibrium", carried, carried == 1)
        self._require("rest again", again, again == 0)
        self._require("lift-off", last[_PLANE], last[_PLANE] == 0)

    def title(self, command: np.ndarray) -> str:
        """Name of the problem, for error messages."""
        del command
        return "the stop and start of the gait in place"

    def modes(self, solution: StopAndStart, command: np.ndarray) -> list[ModeSolution]:
        """Stop and start, two double stances in a row."""
        feet = command[20:23], command[23:26]
        state = solution.stop_state, solution.start_state
        control = solution.stop_control, solution.start_control
        return [
            ModeSolution(Mode.DOUBLE, state[i], control[i], feet, float(solution.duration[i]))
            for i in range(2)
        ]

    def rough_guess(self, ends: np.ndarray) -> StopAndStart:
        """Initial guess: cubics between the ends and a rest on almost straight legs."""
        p, height, duration = self.parameters, 0.93, 0.4
        touchdown, lift_off, left, right = np.split(ends, [10, 20, 23])
        rest = np.zeros(STATE_SIZE)
        rest[:3] = (left + right) / 2 + [0.0, 0.0, height]
        length = np.linalg.norm(rest[:3] - left)
        force = p.weight / 2 * length / height
        rest[6:8] = length + force / p.stiffness
        control = np.full((CONTROL_SIZE, POINTS + 1), force / p.actuator_inertia)
        return StopAndStart(
            stop_state=_cubic(touchdown, rest, duration),
            start_state=_cubic(rest, lift_off, duration),
            stop_control=control,
            start_control=control,
            duration=np.full(2, duration),
        )


def _cubic(first: np.ndarray, last: np.ndarray, duration: float) -> np.ndarray:
    """States (10, 2 N + 1) on the cubic between two states (10,)."""
    ends = np.stack([first, last])
    spline = CubicHermiteSpline([0.0, duration], ends[:, _VALUES], ends[:, _RATES])
    time, state = np.linspace(0.0, duration, POINTS + 1), np.zeros((STATE_SIZE, POINTS + 1))
    state[_VALUES], state[_RATES] = spline(time).T, spline(time, 1).T
    return state


@lru_cache(maxsize=4)
def stop_start_problem(parameters: SlipParameters) -> StopStartProblem:
    """Problem for given parameters, built on first use."""
    return StopStartProblem(parameters)


def ends_of_gait(gait: Gait) -> np.ndarray:
    """(26,) states at left touchdown and at right lift-off (10 + 10), left and right foot (3 + 3).

    Raises:
        ConfigurationError: the gait does not step in place.
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    if gait.command.any():
        raise ConfigurationError(
            f"stop and start belong to the gait in place, got that at {gait.command.tolist()}"
        )
    tracks = gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity
    state = np.hstack(tracks)
    return np.concatenate([state[POINTS], state[2 * POINTS], gait.feet.position[POINTS].ravel()])


def transitions_from_modes(
    modes: Sequence[ModeSolution], certificate: Certificate, p: SlipParameters
) -> tuple[Transition, Transition]:
    """Stop and start from their two solved modes."""
    stop, start = (
        Transition(
            stride=mode.duration,
            time=np.linspace(0.0, mode.duration, mode.state.shape[1]),
            body=Track(mode.state[0:3].T, mode.state[3:6].T),
            feet=np.stack(mode.feet),
            set_point=mode.state[6:8].T,
            set_point_velocity=mode.state[8:10].T,
            control=mode.control.T,
            certificate=certificate,
            parameters=p,
        )
        for mode in modes
    )
    return stop, start
