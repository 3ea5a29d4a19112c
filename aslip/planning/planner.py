"""Exact plans: branch and bound over stones, with DAQP for the quadratic programs in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

from aslip.errors import SolverError
from aslip.planning.plan import Plan
from aslip.planning.program import Problem, Program
from aslip.planning.state import WalkState
from aslip.planning.stones import Stones

# directions along which the speed of the swing foot is limited
_AROUND = np.arange(8) * (np.pi / 4)
_DIRECTIONS = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=1)
# times of the chords below the curve of the time, as shares between its least and greatest
_CHORDS = np.array([0.0, 0.4, 1.0])
# share of the limit of speed that is left to a foot against the motion of the body
_SLOWEST = 0.2
# DAQP's mark of a constraint that may be violated at a cost
_SOFT = 8
# cost by which a node must be better [-]
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class _Rows:
    """Constraints low <= matrix x <= high; the first bound is that of x[0] alone."""

    matrix: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, eq=False)
class _Found:
    """Optimum of a program, and the stones of its first steps."""

    variables: np.ndarray
    cost: float
    stones: tuple[int, ...] = ()
    within_limits: bool = True
    on_stones: bool = True


class Planner:
    """Optimal footsteps of robots, one after another, as NumPy arrays.

    Args:
        program: model, limits, weights and number of steps.
    """

    def __init__(self, program: Program | None = None) -> None:
        self.program = program or Program()
        steps = self.program.steps
        self._hessian = np.zeros((2 + 2 * steps, 2 + 2 * steps))
        self._hessian[1:-1, 1:-1] = 2 * np.kron(self.program.matrix, np.eye(2))

    def plan(
        self,
        state: WalkState,
        command: np.ndarray,
        stones: Stones | None = None,
        aim: np.ndarray | None = None,
    ) -> Plan:
        """Plan footsteps.

        Without stones the floor is flat, at the height of the stance foot. If no stones are
        possible for all steps, the last steps are free. If none is possible for the next step, it
        comes as close to a stone as the limits allow; if these cannot be kept, it violates them
        least. The plan says so, see `Plan.on_stones` and `Plan.within_limits`.

        Args:
            state: state of n robots.
            command: (n, 3) forward speed, sideways speed [m/s] and yaw rate [rad/s].
            stones: stones in the frame of the state.
            aim: (n, 2) foothold that the foot in flight was going to [m], NaN for none: other
                stones cost more the further they are from it, so that noise does not change it.

        Raises:
            SolverError: there is no solution, as for a state or command that is not finite.
        """
        problem = self.program.problem(state, command)
        found = [
            StoneSearch(
                self,
                _row(problem, i),
                stones and stones.select(i),
                None if aim is None else aim[i : i + 1],
            ).best()
            for i in range(len(state.since))
        ]
        variables = np.array([one.variables for one in found])
        if not np.isfinite(variables).all():
            raise SolverError("the footsteps are not finite; state and command must be finite")
        chosen = np.full((len(found), self.program.steps), -1)
        for row, one in zip(chosen, found, strict=True):
            row[: len(one.stones)] = one.stones
        return Plan.of(
            self.program,
            problem.pressed(variables[:, -1]),
            state,
            command,
            variable=variables[:, 0],
            steps=variables[:, 1:-1].reshape(len(found), -1, 2),
            stones=stones,
            chosen=chosen,
            on_stones=np.array([len(one.stones) if one.on_stones else 0 for one in found]),
            within_limits=np.array([one.within_limits for one in found]),
            cost=np.array([one.cost for one in found]),
        )

    def objective(self, problem: Problem) -> tuple[np.ndarray, np.ndarray, float]:
        """Matrix, vector and constant of the cost x H x / 2 + f x + c of a robot, n = 1.

        The variables x are t, the steps and z.
        """
        bend, cross, slope, slopes, constant = self.program.cost(problem)
        hessian = self._hessian.copy()
        hessian[0, 0] = bend[0]
        hessian[0, 1:-1] = hessian[1:-1, 0] = cross.ravel()
        program, weight = self.program, self.program.weight[:, None]
        (error, rate), pressed = program.errors(problem), program.by_pressure(problem)[0][0]
        hessian[-1, -1] = 2 * program.weights.pressure + 2 * (weight * pressed**2).sum()
        hessian[0, -1] = hessian[-1, 0] = 2 * (weight * rate[0] * pressed).sum()
        across = 2 * program.error.T @ (weight * pressed)
        hessian[-1, 1:-1] = hessian[1:-1, -1] = across.ravel()
        last = [2 * (weight * error[0] * pressed).sum()]
        return hessian, np.concatenate([slope, slopes.ravel(), last]), float(constant[0])

    def limits(self, problem: Problem, *, on_stones: bool) -> _Rows:
        """Limits of the robot, n = 1: speed of the foot, centre of pressure, steps, reach."""
        limits, steps = self.program.limits, self.program.steps
        fast = self._speed(problem)
        count = len(fast[0])
        matrix = np.zeros((count + 1 + 4 * steps, 2 + 2 * steps))
        low, high = np.full(1 + len(matrix), -np.inf), np.empty(1 + len(matrix))
        # the centre of pressure follows the speeds
        matrix[count, -1], most = 1.0, limits.pressure if on_stones else 0.0
        low[1 + count], high[1 + count] = -most, most
        low[0], high[0] = self.program.variable(problem, problem.times[:, ::2])[0]
        matrix[:count, :3], high[1 : count + 1] = fast
        count += 1
        # steps and feet relative to the body, along and across the heading, outward positive
        cosine, sine, side = np.cos(problem.heading[0]), np.sin(problem.heading[0]), problem.side[0]
        turn = np.array([[cosine, sine], [-side * sine, side * cosine]]).transpose(2, 0, 1)
        k = np.arange(steps)
        by_axis = np.zeros((2, steps, 2, steps, 2))
        by_axis[0, k, :, k] = turn
        constant, by_time, by_step = self.program.reach(problem)
        by_axis[1] = -np.einsum("kl,kij->kilj", by_step, turn)
        matrix[count:, 1:-1] = by_axis.reshape(4 * steps, 2 * steps)
        pressed = sum(self.program.by_pressure(problem))[0] / 2
        matrix[count + 2 * steps :, -1] = -np.einsum("kij,kj->ki", turn, pressed).ravel()
        matrix[count + 2 * steps :, 0] = -np.einsum("kij,kj->ki", turn, by_time[0]).ravel()
        middle = -np.einsum("kij,kj->ki", turn, constant[0])
        box = np.array([limits.length, limits.width])
        reach = np.array([limits.reach, limits.outward])
        for bound, end in ((low, 0), (high, 1)):
            bound[1 + count :] = np.concatenate(
                [np.tile(box[:, end], steps), (reach[:, end] - middle).ravel()]
            )
        return _Rows(matrix, low, high)

    def _speed(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Rows (r, 3) for t and the first step, and their upper bounds (r,)."""
        least, _, greatest = problem.times[0]
        times = least + _CHORDS * (greatest - least)
        at = self.program.variable(problem, times[None])[0]
        slope = np.diff(times) / np.diff(at)
        # time in flight >= start + slope t, of which the least chord is the curve's lower bound
        start = times[:-1] - slope * at[:-1] - problem.shift[0]
        fast = self.program.limits.foot_speed
        speed = np.maximum(fast + _DIRECTIONS @ problem.velocity[0], _SLOWEST * fast)
        rows = np.empty((len(speed), len(slope), 3))
        rows[..., 0] = -speed[:, None] * slope
        rows[..., 1:] = _DIRECTIONS[:, None]
        bound = (
            speed[:, None] * start
            - (_DIRECTIONS @ (problem.stance - problem.swing)[0, :2])[:, None]
        )
        return rows.reshape(-1, 3), bound.ravel()


class StoneSearch:
    """Branch and bound over the stones of one robot.

    Each node is a program in which the first steps have stones and the others are free, so that its
    cost is a lower bound.

    Args:
        planner: planner with the program.
        problem: program of the robot, n = 1.
        stones: its stones, or None for flat floor.
        aim: (1, 2) where its foot in flight was going to, or None.
    """

    def __init__(
        self,
        planner: Planner,
        problem: Problem,
        stones: Stones | None,
        aim: np.ndarray | None = None,
    ) -> None:
        program = planner.program
        self._steps = program.steps
        self._hessian, self._slope, self._constant = planner.objective(problem)
        limits = planner.limits(problem, on_stones=stones is not None)
        self._fixed = len(limits.high)
        self.kept: Any = () if stones is None else _near(program, problem, stones)
        self._edges = stones.normals.shape[2] if stones is not None else 0
        rows = self._fixed + self._steps * self._edges
        # the edges of the stones chosen so far follow the limits
        self._matrix = np.zeros((rows - 1, 2 + 2 * self._steps))
        self._low, self._high = np.full(rows, -np.inf), np.empty(rows)
        self._matrix[: self._fixed - 1] = limits.matrix
        self._low[: self._fixed], self._high[: self._fixed] = limits.low, limits.high
        self.nodes = 0
        """Programs solved."""
        heights = problem.stance[:, 2:]
        if stones is not None:
            self._prepare(program, problem, stones)
            if aim is not None:
                change = program.weights.change_of(stones, aim)[0, self.kept]
                self._extra[0] = self._extra[0] + change
            heights = stones.heights[:, self.kept]
        self._least = program.variable(problem, program.least_time(problem, heights))[0]
        if stones is None:
            self._low[0] = self._least[0]

    def _prepare(self, program: Program, problem: Problem, stones: Stones) -> None:
        """Edges, relative to the stance foot; extra cost of stones, and possibility of pairs."""
        limits, stance = program.limits, problem.stance[0]
        used = program.used[:, None, None]
        shrunk = stones.shrunk(problem.heading, limits.half_foot, limits.margin, used)[0]
        self._normals = stones.normals[0, self.kept]
        self._offsets = shrunk[:, self.kept] - self._normals @ stance[:2]
        # a foothold is the sum of all steps to it
        self._repeated = np.tile(self._normals, self._steps)
        # the stance foot comes first, as a point
        corners = np.concatenate(
            [np.broadcast_to(stance[:2], (1, self._edges, 2)), stones.corners[0, self.kept]]
        )
        tops = np.concatenate([stance[2:], stones.heights[0, self.kept]])
        cosine, sine, side = np.cos(problem.heading[0]), np.sin(problem.heading[0]), problem.side[0]
        axes = np.stack([[cosine, sine], [-side * sine, side * cosine]]).transpose(0, 2, 1)
        along = np.einsum("ask,mek->asme", axes, corners)
        least, most = along.min(-1), along.max(-1)
        (low_x, high_x), (low_y, high_y) = limits.length, limits.width
        # entry [s, i, j]: from i to j at step s
        far = most[:, :, None, 1:] - least[:, :, :, None]
        near = least[:, :, None, 1:] - most[:, :, :, None]
        self._level = abs(tops[1:] - tops[:, None]) <= limits.rise + _TOLERANCE
        self._possible = (
            (far[0] >= low_x) & (near[0] <= high_x) & (far[1] >= low_y) & (near[1] <= high_y)
        ) & self._level
        # variances of the footholds, sums of the steps to them, where the cost is a density
        steps = np.linalg.inv(self._hessian)[1:-1, 1:-1].reshape(self._steps, 2, self._steps, 2)
        k = np.arange(self._steps)
        spread = steps.cumsum(axis=0).cumsum(axis=2)[k, :, k]
        along = np.einsum("mei,sij,mej->sme", self._normals, spread, self._normals)
        self._stiffness = 0.5 / along
        foot = limits.half_foot + limits.margin
        self._extra = program.weights.stay_of(problem, stones, foot)[0][:, self.kept]

    def best(self) -> _Found:
        """Optimum, or the safest step."""
        self._best = _Found(np.zeros(0), np.inf)
        root = self._solve(0)
        if root is None:
            return self._nearest(within_limits=False)
        if self._edges == 0:
            return _Found(root[0], root[1] + self._constant)
        self._visit((), -1, root, 0.0)
        if not self._best.stones:
            return self._nearest(within_limits=True)
        found = self._best
        stones = tuple(int(self.kept[i]) for i in found.stones)
        return _Found(found.variables, found.cost + self._constant, stones)

    def cost(self, sequence: Sequence[int]) -> float:
        """Cost of a sequence of `kept` stones by index, as given; infinite if impossible."""
        last, extra = -1, self._constant
        for depth, stone in enumerate(sequence):
            if not self._level[last + 1, stone]:
                return np.inf
            self._place(depth, stone)
            extra, last = extra + float(self._extra[depth, stone]), stone
        solved = self._solve(len(sequence))
        return np.inf if solved is None else solved[1] + extra

    def _visit(
        self, stones: tuple[int, ...], last: int, solved: tuple[np.ndarray, float], extra: float
    ) -> None:
        """Try stones for the step after the given ones, the most promising first.

        Args:
            stones: stones of the first steps.
            last: the last of them.
            solved: optimum with these, and its cost.
            extra: cost of the stones themselves.
        """
        depth, possible = len(stones), np.flatnonzero(self._possible[len(stones), last + 1])
        bounds = solved[1] + self._bound(depth, possible, solved[0])
        bounds = bounds + extra + self._extra[depth, possible]
        for k in np.argsort(bounds):
            i, worst = int(possible[k]), self._best.cost - _TOLERANCE
            # more steps on stones count more than cost
            if len(self._best.stones) == self._steps and bounds[k] >= worst:
                break
            self._place(depth, i)
            found = self._solve(depth + 1)
            if found is None:
                continue
            chosen, more = (*stones, i), extra + float(self._extra[depth, i])
            value = (-len(chosen), found[1] + more)
            if value < (-len(self._best.stones), self._best.cost):
                self._best = _Found(found[0], value[1], chosen)
            elif len(self._best.stones) == self._steps and value[1] >= worst:
                continue
            if len(chosen) < self._steps:
                self._visit(chosen, i, found, more)

    def _bound(self, depth: int, stones: np.ndarray, variables: np.ndarray) -> np.ndarray:
        """Least additional cost of stones (k,) for a step, from the optimum without them.

        The cost rises at least as fast from there as it would without constraints.
        """
        place = variables[1:-1].reshape(-1, 2)[: depth + 1].sum(axis=0)
        beyond = self._normals[stones] @ place - self._offsets[depth, stones]
        return (beyond.clip(0.0) ** 2 * self._stiffness[depth, stones]).max(axis=1)

    def _place(self, depth: int, stone: int) -> None:
        """Let the step at a depth end on a stone."""
        first = self._fixed + depth * self._edges
        kept = slice(first - 1, first - 1 + self._edges)
        self._matrix[kept, 1 : 3 + 2 * depth] = self._repeated[stone, :, : 2 + 2 * depth]
        self._high[first : first + self._edges] = self._offsets[depth, stone]
        if depth == 0:
            self._low[0] = self._least[stone]

    def _solve(self, depth: int, soft: int | None = None) -> tuple[np.ndarray, float] | None:
        """Optimum with stones for some first steps; None if impossible.

        Args:
            depth: number of these steps.
            soft: first bound that may be violated.
        """
        self.nodes += 1
        rows = self._fixed + depth * self._edges
        sense = np.zeros(rows, dtype=np.int32)
        if soft is not None:
            sense[soft:] = _SOFT
        x, cost, flag, _ = daqp.solve(
            self._hessian,
            self._slope,
            self._matrix[: rows - 1],
            self._high[:rows],
            self._low[:rows],
            sense,
        )
        return (x, cost) if flag > 0 else None

    def _nearest(self, *, within_limits: bool) -> _Found:
        """Step that violates least: the edges of a stone, and the limits if they must."""
        # without stones, or if none has a solution, none is chosen
        best = self._solve(0, None if within_limits else 1)
        best = None if best is None else (best[0], np.inf if len(self.kept) else best[1])
        for i in range(len(self.kept)):
            self._place(0, i)
            found = self._solve(1, self._fixed if within_limits else 1)
            if found is not None and (best is None or found[1] < best[1]):
                best = found
        if best is None:  # of a robot that falls: the foot stays where it is
            best = (np.zeros(len(self._hessian)), np.inf)
        return _Found(best[0], best[1] + self._constant, (), within_limits, False)


def _near(program: Program, problem: Problem, stones: Stones) -> np.ndarray:
    """Indices of the stones that are there, near enough to be reached in all steps."""
    limits = program.limits
    longest = np.hypot(max(np.abs(limits.length)), max(np.abs(limits.width)))
    away = np.abs(stones.corners[0] - problem.stance[0, :2]).max(axis=-1).min(axis=-1)
    return np.flatnonzero(stones.present[0] & (away <= program.steps * longest))


def _row(problem: Problem, index: int) -> Problem:
    """Program of one robot, n = 1."""
    return Problem(**{name: value[index : index + 1] for name, value in vars(problem).items()})
