r"""Quadratic program of the next footsteps.

Variables are :math:`t`, about the time by which the next touchdown is later than nominal, the
steps :math:`d_1 \dots d_N` from foothold to foothold and, on stones, the distance z of the centre
of pressure along the stance foot. With :math:`e^{\omega \tau} = e^{\omega
\bar\tau} (1 + \omega t)` in place of the time :math:`\tau` until the next touchdown, the offsets
:math:`e_k = \xi_k - p_k` of the divergent component from the foot at each touchdown are linear,

.. math:: e_1 = e^{\omega \tau} u_0 - d_1, \qquad
    e_{k+1} = \sigma (e_k + \beta d_k) - d_{k+1}, \qquad \sigma = e^{\omega T},

see `aslip.planning.pendulum`. Later steps take the nominal time T: each is the next one in time.
The cost is the sum of weighted squares of t, of :math:`d_k` and of :math:`e_k`, the last two less
those of the periodic walk at the command. Limits of the robot are linear constraints. The
convergent component, which they need, contains :math:`e^{-\omega\tau}`, linearised at
:math:`\bar\tau`; the limit of the foot's speed contains :math:`\tau`, of which chords lie below.

The cost's matrix is constant apart from the row of t, so that without constraints the optimum is
closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aslip.base.arrays import Array, is_numpy, namespace
from aslip.base.checks import TINY, check_count, check_number
from aslip.planning.limits import Limits, Weights
from aslip.planning.pendulum import Pendulum
from aslip.planning.state import LATER, SETTLE, WalkState
from aslip.planning.stones import Stones

# least time until a touchdown, and least freedom in it [s]
_SOONEST = 0.01
# distance of the feet of a periodic walk beyond its limit [m]
_ROOM = 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Numbers of the programs of n robots with N steps."""

    times: Array
    """(n, 3) least, nominal and greatest time until the next touchdown [s]."""
    shift: Array
    """(n,) time until the swing foot lifts off, 0 in flight [s]."""
    begin: Array
    """(n,) time at which it lifted off or does, later by that in which it is above its foothold
    before the touchdown [s]."""
    growth: Array
    """(n, 2) divergent component at the nominal touchdown, from the stance foot [m]."""
    decay: Array
    """(n, 2) convergent component there [m]."""
    toes: Array
    """(n, 2) direction of the stance foot."""
    gain: Array
    """(n, 2) what both components there lose by the distance z of the centre of pressure along the
    toes; they gain z, too [-]."""
    pressure: Array
    """(n, 2) centre of pressure, from the stance foot [m]."""
    heading: Array
    """(n, N) heading at the touchdowns [rad]."""
    side: Array
    """(n, N) 1 where the left foot lands, -1 where the right foot does."""
    step: Array
    """(n, N, 2) steps of the command [m]."""
    offset: Array
    """(n, N, 2) offsets of the divergent component of the command, less those of its steps [m]."""
    stance: Array
    """(n, 3) stance foot [m]."""
    swing: Array
    """(n, 3) swing foot [m]."""
    lift_off: Array
    """(n, 3) where it lifted off, or does [m]."""
    velocity: Array
    """(n, 2) of the body [m/s]."""
    ahead: Array
    """(n, 2) step of the command, without the distance of the feet [m]."""
    change: Array
    """(n,) weight of other t than `before`, 0 for feet that are not in flight [1/s^2]."""
    before: Array
    """(n,) t at which a foot in flight was to land."""
    on_stones: Array
    """(n,) bool, whether there are stones."""
    fast: Array
    """(n,) largest mean speed of the swing foot [m/s]."""

    @cached_property
    def axes(self) -> Array:
        """(n, N, 2, 2) rows of the directions ahead and outward at the touchdowns."""
        xp, side = namespace(self.heading), self.side
        cosine, sine = xp.cos(self.heading), xp.sin(self.heading)
        rows = xp.stack([cosine, sine, -side * sine, side * cosine], -1)
        return rows.reshape(*side.shape, 2, 2)

    @property
    def swings(self) -> tuple[tuple[Array, Array], ...]:
        """Times (n,) and places (n, 3) from which the foot's speed is limited, see `Limits`."""
        return (self.shift, self.swing), (self.begin, self.lift_off)

    def pressed(self, distance: Array) -> Problem:
        """Programs with the centre of pressure by (n,) along the toes [m], from one without."""
        place = distance[:, None] * self.toes
        return replace(
            self,
            growth=self.growth - self.gain[:, :1] * place,
            decay=self.decay - self.gain[:, 1:] * place,
            pressure=place,
        )


class Program:
    """Constants of the program, and the programs of robots.

    Args:
        pendulum: model of a step.
        limits: limits of the robot.
        weights: weights of the cost.
        steps: number N of steps.
        width: lateral distance of the feet of a walk straight ahead [m].

    Raises:
        ConfigurationError: fewer than two steps, a width that is not positive, or limits whose
            reserve leaves nothing of a stone.
    """

    def __init__(
        self,
        pendulum: Pendulum | None = None,
        limits: Limits | None = None,
        weights: Weights | None = None,
        steps: int = 4,
        width: float = 0.2,
    ) -> None:
        self.pendulum = p = pendulum or Pendulum()
        self.limits, self.weights = limits or Limits(), weights or Weights()
        self.steps, self.width = check_count("steps", steps, 2), check_number("width", width, TINY)
        check_number("reserve", self.limits.reserve, 0.0, 1 / steps, "of a program's limits")
        self.used = 1 - self.limits.reserve * np.arange(steps)
        """(N,) share of a stone, less its margins, that each step may use."""
        self._growth, self._decay = (self._offsets(sign) for sign in (1, -1))
        self.sigma = np.exp(p.rate * p.step_time)
        self._expected = self._of_steps()
        self.error = matrix = self._growth[0] - self._expected
        """(N, N) offsets other than those of longer steps, by the steps along one axis."""
        weight = np.full(steps, self.weights.offset)
        weight[-1] = self.weights.last
        self.weight = weight
        self.matrix = self.weights.step * np.eye(steps) + matrix.T @ (weight[:, None] * matrix)
        """(N, N) matrix of the steps' cost along one axis."""

    def _offsets(self, sign: int) -> tuple[np.ndarray, np.ndarray]:
        """Matrix (N, N) and vector (N,): offsets of a component from steps and from the first."""
        p, (i, j) = self.pendulum, np.indices((self.steps, self.steps))
        sigma = np.exp(sign * p.rate * p.step_time)
        beta = p.shift(sign, np.array(p.double_stance))
        lower = np.where(i > j, sigma ** np.maximum(i - j, 0) * (beta - 1), 0.0)
        return lower - np.eye(self.steps), sigma ** np.arange(self.steps)

    def _of_steps(self) -> np.ndarray:
        """Matrix (N, N): offsets of walks whose steps are longer, from the mean of the last two."""
        p = self.pendulum
        beta = p.shift(1, np.array(p.double_stance))
        mean = (np.eye(self.steps) + np.eye(self.steps, k=-1)) / 2
        mean[0, 0] = 1
        return mean * (1 - self.sigma * beta) / (self.sigma - 1)

    def problem(
        self,
        state: WalkState,
        command: Array,
        stones: Stones | None = None,
        aim: Array | None = None,
    ) -> Problem:
        """Programs of n robots.

        Args:
            state: state of the robots.
            command: (n, 3) forward speed, sideways speed [m/s] and yaw rate [rad/s].
            stones: their stones, see `aslip.planning.Planner.plan`.
            aim: see `aslip.planning.Planner.plan`.
        """
        xp, p, limits = namespace(state.since), self.pendulum, self.limits
        stance = state.of_foot(state.foot_position, swing=False)
        foot = state.of_foot(state.foot_position, swing=True)
        shift = (p.double_stance - state.since).clip(0.0)
        least = (limits.step_time[0] - state.since).clip(_SOONEST)
        least = xp.maximum(least, shift)
        greatest = xp.maximum(limits.step_time[1] - state.since, least + _SOONEST)
        if aim is not None:
            # NaN, for feet that are not in flight, does not count
            least = xp.fmax(least, xp.minimum(aim[:, 2] - limits.sooner, greatest - _SOONEST))
        nominal = xp.minimum(xp.maximum(p.step_time - state.since, least), greatest)
        start = pressure(state, p.double_stance)
        body, velocity = state.body_position[:, :2], state.body_velocity[:, :2]
        components, gain = [], []
        for sign in (1, -1):
            factor, beta = xp.exp(sign * p.rate * nominal), p.shift(sign, shift)
            from_foot = body + velocity * (sign / p.rate) - stance[:, :2]
            moved = from_foot + beta[:, None] * (stance[:, :2] - start)
            components.append(moved * factor[:, None])
            gain.append(factor * (1 - beta))
        toes = state.of_foot(state.foot_heading, swing=False)
        order = xp.arange(self.steps, device=state.since.device)
        side = 1 - 2 * ((1 - state.stance[:, None] + order) % 2)
        heading = command[:, 2:] * (nominal[:, None] + p.step_time * order)
        step, offset = self.periodic(command, heading, side)
        offset = offset - like(self._expected, offset) @ step
        change = before = 0 * nominal
        if aim is not None:
            flies = xp.isfinite(aim[:, 2])
            left = xp.where(flies, aim[:, 2], nominal)
            change = xp.where(flies, change + self.weights.change_time, change)
            before = xp.expm1(p.rate * (left - nominal)) / p.rate
        on_stones = xp.zeros_like(state.stance, dtype=bool)
        if stones is not None:
            on_stones = on_stones | stones.present.any(1)
        return Problem(
            times=xp.stack([least, nominal, greatest], -1),
            shift=shift,
            begin=p.double_stance - state.since + SETTLE,
            growth=components[0],
            decay=components[1],
            toes=xp.stack([xp.cos(toes), xp.sin(toes)], -1),
            gain=xp.stack(gain, -1),
            pressure=0 * stance[:, :2],
            heading=heading,
            side=side,
            step=step,
            offset=offset,
            stance=stance,
            swing=foot,
            lift_off=state.lift_off,
            velocity=velocity,
            ahead=command[:, :2] * p.step_time,
            change=change,
            before=before,
            on_stones=on_stones,
            fast=limits.floor_speed + on_stones * (limits.foot_speed - limits.floor_speed),
        )

    def periodic(self, command: Array, heading: Array, side: Array) -> tuple[Array, Array]:
        """Steps and offsets (n, N, 2) of the periodic walk at commands (n, 3)."""
        xp, p, sigma = namespace(heading), self.pendulum, self.sigma
        beta = p.shift(1, np.array(p.double_stance)).item()
        # points of the plane as complex numbers, in the frame of each touchdown
        turn = p.step_time * command[:, 2]
        half = xp.exp(-0.5j * turn)
        ahead = p.step_time * xp.sinc(turn / (2 * np.pi)) * (command[:, 0] + 1j * command[:, 1])
        least = p.step_time * abs(command[:, 1]) + self.limits.width[0] + _ROOM
        width = 1j * half * xp.maximum(least, xp.zeros_like(least) + self.width)
        ahead, turn = ahead * half, xp.exp(1j * turn)
        mean = ahead * (sigma * beta - turn) / (turn - sigma)
        sway = -width * (sigma * beta + turn) / (sigma + turn)
        frame = xp.exp(1j * heading)
        step = frame * (ahead[:, None] + side * width[:, None])
        offset = frame * (mean[:, None] + side * sway[:, None])
        return xp.stack([step.real, step.imag], -1), xp.stack([offset.real, offset.imag], -1)

    def cost(self, problem: Problem) -> tuple[Array, Array, Array, Array, Array]:
        """Cost of t and the steps d: a t^2 / 2 + t b' d + d' M d + f t + g' d + constant.

        Returns:
            a (n,), b (n, N, 2), f (n,), g (n, N, 2) and the constant (n,); M is `matrix`.
        """
        matrix, weight = like(self.error, problem.growth), like(self.weight, problem.growth)
        error, rate = self.errors(problem)
        weighed = weight[:, None] * error
        bend = 2 * (self.weights.time + problem.change)
        bend = bend + 2 * (weight[:, None] * rate**2).sum((-2, -1))
        cross = 2 * matrix.T @ (weight[:, None] * rate)
        slope = 2 * ((weighed * rate).sum((-2, -1)) - problem.change * problem.before)
        slopes = 2 * (matrix.T @ weighed - self.weights.step * problem.step)
        constant = (weighed * error).sum((-2, -1)) + self.weights.step * (problem.step**2).sum(
            (-2, -1)
        )
        constant = constant + problem.change * problem.before**2
        return bend, cross, slope, slopes, constant

    def errors(self, problem: Problem) -> tuple[Array, Array]:
        """Offsets (n, N, 2) other than the command's, without steps at the nominal time; and by t.

        By the steps they are `error`.
        """
        powers = like(self._growth[1], problem.growth)[:, None]
        first = powers * problem.growth[:, None]
        error = first + powers * problem.pressure[:, None] - problem.offset
        return error, self.pendulum.rate * first

    def by_pressure(self, problem: Problem) -> tuple[Array, Array]:
        """Divergent and convergent offsets (n, N, 2) by the distance z of the centre of pressure.

        They are those at the nominal touchdown.
        """
        toes = problem.toes[:, None]
        return tuple(
            like(powers, toes)[:, None] * (1 - problem.gain[:, i, None, None]) * toes
            for i, powers in enumerate((self._growth[1], self._decay[1]))
        )  # pyright: ignore[reportReturnType]

    def pressure(self, problem: Problem, variable: Array, steps: Array) -> Array:
        """Optimal distance z (n,) of the centre of pressure, of programs without, at t and steps.

        Args:
            problem: programs, with the centre of pressure on the foot.
            variable: (n,) t.
            steps: (n, N, 2) steps [m].
        """
        powers, weight = (like(one, steps) for one in (self._growth[1], self.weight))
        error, rate = self.errors(problem)
        off = error + variable[:, None, None] * rate + like(self.error, steps) @ steps
        factor = 1 + self.pendulum.rate * variable
        by = powers * (1 - factor * problem.gain[:, 0])[:, None]
        along = (off * problem.toes[:, None]).sum(-1)
        most = self.limits.pressure
        bend = self.weights.pressure + (weight * by**2).sum(-1)
        return (-(weight * by * along).sum(-1) / bend).clip(-most, most)

    def value(self, cost: tuple[Array, ...], variable: Array, steps: Array) -> Array:
        """Cost (n,) of t (n,) and steps (n, N, 2)."""
        bend, cross, slope, slopes, constant = cost
        along = (slopes + variable[:, None, None] * cross) * steps
        bent = (like(self.matrix, steps) @ steps) * steps
        first = (bend * variable / 2 + slope) * variable + constant
        return first + (along + bent).sum((-2, -1))

    def later(self, problem: Problem, variable: Array) -> Array:
        """Time (n,) until the next touchdown of the variable t (n,) [s]."""
        xp, rate = namespace(variable), self.pendulum.rate
        return problem.times[:, 1] + xp.log1p(rate * variable) / rate

    def variable(self, problem: Problem, time: Array) -> Array:
        """Variable t (n, ...) of times (n, ...) until the next touchdown."""
        xp, rate = namespace(time), self.pendulum.rate
        return xp.expm1(rate * (time - problem.times[:, 1:2])) / rate

    def bodies(self, problem: Problem, variable: Array, steps: Array) -> tuple[Array, Array]:
        """Body relative to the landing foot, and its velocity, at the touchdowns (n, N, 2)."""
        factor = (1 + self.pendulum.rate * variable)[:, None, None]
        divergent, convergent = (
            like(matrix, steps) @ steps
            + like(powers, steps)[:, None] * (start + problem.pressure[:, None])
            for (matrix, powers), start in (
                (self._growth, problem.growth[:, None] * factor),
                (self._decay, problem.decay[:, None] / factor),
            )
        )
        half = self.pendulum.rate / 2
        return (divergent + convergent) / 2, (divergent - convergent) * half

    def least_time(self, problem: Problem, height: Array) -> Array:
        """Least times (n, m) until the foot can come down to heights (n, m) [s]."""
        xp = namespace(height)
        least, _, greatest = (problem.times[:, i : i + 1] for i in range(3))
        down = (problem.swing[:, 2:] - height) / self.limits.descent - LATER
        return xp.minimum(xp.maximum(least, down), greatest - _SOONEST / 2)

    def reach(self, problem: Problem) -> tuple[Array, Array, Array]:
        """Body relative to the foot at touchdowns: constant (n, N, 2), by t (n, N, 2), by d (N, N).

        The matrix acts along each axis alike.
        """
        constant = by_time = 0.0
        by_step = np.zeros((self.steps, self.steps))
        for sign, (matrix, powers), start in (
            (1, self._growth, problem.growth),
            (-1, self._decay, problem.decay),
        ):
            first = like(powers, start)[:, None] * start[:, None] / 2
            pressed = like(powers, start)[:, None] * problem.pressure[:, None] / 2
            constant = constant + first + pressed
            by_time = by_time + sign * self.pendulum.rate * first
            by_step = by_step + matrix / 2
        return constant, by_time, by_step


def pressure(state: WalkState, double_stance: float) -> Array:
    """Centre of pressure (n, 2) now, which moves to the stance foot in double stance."""
    share = (state.since / double_stance).clip(0.0, 1.0)[:, None]
    stance = state.of_foot(state.foot_position, swing=False)
    return (state.lift_off * (1 - share) + stance * share)[:, :2]


def like(values: np.ndarray, other: Array) -> Array:
    """Constants as an array of the kind of another."""
    if is_numpy(other):
        return values
    return namespace(other).as_tensor(values, dtype=other.dtype, device=other.device)
