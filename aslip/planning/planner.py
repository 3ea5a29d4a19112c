"""Exact plans: the quadratic programs of robots, and the search for the best stones of each."""

from __future__ import annotations

import numpy as np

from aslip.base.checks import TINY
from aslip.errors import SolverError
from aslip.planning.plan import Plan
from aslip.planning.program import Problem, Program
from aslip.planning.search import Choices, Programs, StoneSearch
from aslip.planning.state import WalkState
from aslip.planning.stones import Stones

# directions along which the speed of the swing foot is limited
_AROUND = np.arange(8) * (np.pi / 4)
_DIRECTIONS = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=1)
# times of the chords below the curve of the time, as shares between its least and greatest
_CHORDS = np.array([0.0, 0.4, 1.0])
# share of the limit of speed that is left to a foot against the motion of the body
_SLOWEST = 0.2
# difference in height beyond the limit, for rounding errors [m]
_ROUNDING = 1e-9


class Planner:
    """Optimal footsteps of robots, as NumPy arrays.

    Args:
        program: model, limits, weights and number of steps.
    """

    def __init__(self, program: Program | None = None) -> None:
        self.program = program or Program()
        limits, weights, steps = self.program.limits, self.program.weights, self.program.steps
        box, reach = (limits.length, limits.width), (limits.reach, limits.outward)
        self._box, self._reach = (np.tile(np.array(one).T, steps) for one in (box, reach))
        self._by_steps = np.kron(self.program.error, np.eye(2))
        own = [weights.time, *[weights.step] * (2 * steps), weights.pressure]
        self._own = 2 * np.diag(own)

    def plan(
        self,
        state: WalkState,
        command: np.ndarray,
        stones: Stones | None = None,
        shift: np.ndarray | None = None,
        aim: np.ndarray | None = None,
    ) -> Plan:
        """Plan footsteps.

        Robots without stones are on flat floor, at the height of the stance foot. If no stones are
        possible for all steps, the last steps are free. If none is possible for the next step, it
        comes as close to a stone as the limits allow; if these cannot be kept, it violates them
        least. The plan says so, see `Plan.on_stones` and `Plan.within_limits`.

        Args:
            state: state of n robots.
            command: (n, 3) forward speed, sideways speed [m/s] and yaw rate [rad/s].
            stones: stones in the frame of the state; a robot may have none.
            shift: (n, 2) displacement of the next foothold from the optimal one on the floor, as
                far as the limits allow [m].
            aim: (n, 3) foothold ahead and aside that the foot in flight was going to [m] and the
                time until its touchdown [s], NaN for none: other stones and times cost more the
                further they are from it, so that noise does not change them.

        Raises:
            SolverError: a state or command is not finite.
        """
        finite = np.isfinite(np.concatenate([state.to_rows(), command], 1)).all(1)
        if not finite.all():
            lost = np.flatnonzero(~finite).tolist()
            raise SolverError(f"state and command must be finite, those of robots {lost} are not")
        problem = self.program.problem(state, command, stones, aim)
        searches = self.searches(problem, stones, aim)
        found = [search.best() for search in searches]
        if shift is not None:
            for i in np.flatnonzero(~problem.on_stones & shift.any(1)):
                found[i] = searches[i].moved(found[i], shift[i])
        variables = np.array([one.variables for one in found])
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
            on_stones=np.where(
                problem.on_stones, [len(one.stones) for one in found], self.program.steps
            ),
            within_limits=np.array([one.within_limits for one in found]),
            cost=np.array([one.cost for one in found]),
        )

    def searches(
        self, problem: Problem, stones: Stones | None = None, aim: np.ndarray | None = None
    ) -> list[StoneSearch]:
        """Searches for the best stones of n robots, see `plan`."""
        programs, there = self.programs(problem), problem.on_stones
        choices = None if stones is None else self._choices(problem, programs, stones, aim)
        return [StoneSearch(programs, choices if on else None, i) for i, on in enumerate(there)]

    def programs(self, problem: Problem) -> Programs:
        """Programs with the robot's limits: speed of the foot, centre of pressure, steps, reach."""
        program, num = self.program, len(problem.shift)
        limits, steps, by_pressure = program.limits, program.steps, program.by_pressure(problem)
        speed, fastest = self._speed(problem)
        count = speed.shape[1]
        matrix = np.zeros((num, count + 1 + 4 * steps, 2 + 2 * steps))
        low = np.full((num, 1 + matrix.shape[1]), -np.inf)
        high = np.empty_like(low)
        # the centre of pressure follows the speeds
        matrix[:, count, -1], most = 1.0, limits.pressure * problem.on_stones
        low[:, 1 + count], high[:, 1 + count] = -most, most
        times = problem.times[:, ::2].copy()
        # down to the floor; stones have times of their own
        floor = ~problem.on_stones
        times[floor, :1] = program.least_time(problem, problem.stance[:, 2:])[floor]
        low[:, 0], high[:, 0] = program.variable(problem, times).T
        matrix[:, :count, :3], high[:, 1 : count + 1] = speed, fastest
        count += 1
        # steps and feet relative to the body, along and across the heading, outward positive
        turn, k = problem.axes, np.arange(steps)
        by_axis = np.zeros((num, 2, steps, 2, steps, 2))
        by_axis[:, 0, k, :, k] = turn.swapaxes(0, 1)
        constant, by_time, by_step = program.reach(problem)
        by_axis[:, 1] = -by_step[:, None, :, None] * turn[:, :, :, None]
        matrix[:, count:, 1:-1] = by_axis.reshape(num, 4 * steps, 2 * steps)
        pressed = sum(by_pressure) / 2
        columns = np.stack([by_time, pressed, constant], -1)
        along = -(turn @ columns).reshape(num, 2 * steps, 3)
        matrix[:, count + 2 * steps :, 0] = along[..., 0]
        matrix[:, count + 2 * steps :, -1] = along[..., 1]
        for bound, box, reach in zip((low, high), self._box, self._reach, strict=True):
            bound[:, 1 + count : 1 + count + 2 * steps] = box
            bound[:, 1 + count + 2 * steps :] = reach - along[..., 2]
        return Programs(*self._objective(problem, by_pressure[0]), matrix, low, high)

    def _objective(
        self, problem: Problem, pressed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Matrix, vector and constant of the cost, see `Programs`.

        Args:
            problem: programs.
            pressed: the first of `Program.by_pressure`.
        """
        program, weights, steps = self.program, self.program.weights, self.program.steps
        error, rate = (one.reshape(len(one), -1, 1) for one in program.errors(problem))
        weight = 2 * np.repeat(program.weight, 2)
        by_steps = np.broadcast_to(self._by_steps, (len(error), *[2 * steps] * 2))
        by = np.concatenate([rate, by_steps, pressed.reshape(len(error), -1, 1)], -1)
        weighed = (weight[:, None] * by).swapaxes(1, 2)
        vector = (weighed @ error)[..., 0]
        vector[:, 1:-1] -= 2 * weights.step * problem.step.reshape(len(error), -1)
        constant = (weight * error[..., 0] ** 2).sum(-1) / 2
        constant += weights.step * (problem.step**2).sum((1, 2))
        hessian = weighed @ by + self._own
        hessian[:, 0, 0] += 2 * problem.change
        vector[:, 0] -= 2 * problem.change * problem.before
        return hessian, vector, constant + problem.change * problem.before**2

    def _speed(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Rows (n, r, 3) for t and the first step, and their upper bounds (n, r)."""
        num, (least, _, greatest) = len(problem.shift), problem.times.T
        times = least[:, None] + _CHORDS * (greatest - least)[:, None]
        at = self.program.variable(problem, times)
        slope = np.diff(times) / np.diff(at)
        # time >= start + slope t, of which the least chord is the curve's lower bound
        start = times[:, :-1] - slope * at[:, :-1]
        fast = problem.fast[:, None]
        speed = np.maximum(fast + problem.velocity @ _DIRECTIONS.T, _SLOWEST * fast)[..., None]
        rows = np.empty((num, len(_DIRECTIONS), slope.shape[1], 3))
        rows[..., 0] = -speed * slope[:, None]
        rows[..., 1:] = _DIRECTIONS[:, None]
        late = -np.inf
        for begin, place in problem.swings:
            away = (problem.stance - place)[:, :2] @ _DIRECTIONS.T
            late = np.maximum(late, speed * begin[:, None, None] + away[..., None])
        bound = speed * start[:, None] - late
        return rows.reshape(num, -1, 3), bound.reshape(num, -1)

    def _choices(
        self, problem: Problem, programs: Programs, stones: Stones, aim: np.ndarray | None
    ) -> Choices:
        """Edges and costs of stones, and possible pairs of them."""
        program, limits, num = self.program, self.program.limits, len(problem.shift)
        steps, stance, used = program.steps, problem.stance, program.used[:, None, None]
        shrunk = stones.shrunk(problem.heading, limits.half_foot, limits.margin, used)
        edge = (stones.normals @ stance[:, None, :2, None])[..., 0]
        offsets = shrunk - edge[:, None]
        longest = np.hypot(max(np.abs(limits.length)), max(np.abs(limits.width)))
        near = stones.present & ((edge - stones.offsets).max(-1) <= steps * longest)
        # the stance foot comes first, as a point
        edges = stones.corners.shape[2]
        point = np.broadcast_to(stance[:, None, None, :2], (num, 1, edges, 2))
        corners = np.concatenate([point, stones.corners], 1).reshape(num, 1, -1, 2)
        along = (corners @ problem.axes.swapaxes(2, 3)).reshape(num, steps, -1, edges, 2)
        least, most = along.min(3), along.max(3)
        tops = np.concatenate([stance[:, 2:], stones.heights], 1)
        level = np.abs(stones.heights[:, None] - tops[..., None]) <= limits.rise + _ROUNDING
        level &= near[:, None]
        least_step, most_step = self._box[:, :2]
        # entry [n, s, i, j]: from i to j at step s
        far = most[:, :, None, 1:] - least[:, :, :, None]
        close = least[:, :, None, 1:] - most[:, :, :, None]
        possible = ((far >= least_step) & (close <= most_step)).all(-1) & level[:, None]
        # variances of the footholds, sums of the steps to them, where the cost is a density
        inverse = np.linalg.inv(programs.hessian)[:, 1:-1, 1:-1]
        sums = inverse.reshape(num, steps, 2, steps, 2).cumsum(1).cumsum(3)
        k = np.arange(steps)
        spread = sums[:, k, :, k].swapaxes(0, 1)[:, :, None]
        normals = stones.normals[:, None]
        variance = ((normals @ spread) * normals).sum(-1)
        extra = program.weights.stay_of(problem, stones, limits.half_foot + limits.margin)
        if aim is not None:
            extra[:, 0] += program.weights.change_of(stones, aim)
        soonest = program.variable(problem, program.least_time(problem, stones.heights))
        return Choices(
            near=near,
            normals=stones.normals,
            offsets=offsets,
            level=level,
            possible=possible,
            stiffness=0.5 / variance.clip(TINY),
            extra=extra,
            least=soonest,
        )
