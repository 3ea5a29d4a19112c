"""Plans of all robots at once, for training: arrays of NumPy or tensors on any device.

Stones are chosen one after another, not together as in `aslip.planning.planner`: the optimum
without constraints is closed form; the next step goes to the possible stone that adds the least to
its cost, or into the box of the limits; the rest is optimal after it. On these stones, time,
footholds and centre of pressure then approach their optimum in turn. The speed of the foot is
limited by time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from aslip.base.arrays import Array, namespace
from aslip.errors import ConfigurationError
from aslip.planning.plan import Plan
from aslip.planning.program import Problem, Program, like
from aslip.planning.state import WalkState
from aslip.planning.stones import Stones, nearest

# times that time and footholds are improved on their stones
_SWEEPS = 4
# cost of a violated limit [1/m^2], and violation that is none [m, s]
_VIOLATION, _NONE = 1e4, 1e-3


class BatchPlanner:
    """Footsteps of many robots, from numbers in double precision.

    The cost hardly depends on the time of the touchdown, so that single precision loses it. Unlike
    those of `aslip.planning.Planner`, plans on stones are for robots that all have some; their cost
    leaves out that of stones and of the centre of pressure, and `within_limits` is of time alone.

    Args:
        program: model, limits, weights and number of steps.
    """

    def __init__(self, program: Program | None = None) -> None:
        self.program = program or Program()

    def plan(
        self,
        state: WalkState,
        command: Array,
        stones: Stones | None = None,
        shift: Array | None = None,
        aim: Array | None = None,
    ) -> Plan:
        """Plan footsteps, see `aslip.planning.Planner.plan`.

        Args:
            state: state of n robots.
            command: (n, 3) forward speed, sideways speed [m/s] and yaw rate [rad/s].
            stones: stones in the frame of the state.
            shift: (n, 2) displacement of the next foothold from the optimal one [m].
            aim: (n, 3) where and when the foot in flight was to land, see `Planner.plan` [m, s].

        Raises:
            ConfigurationError: the command is in single precision.
        """
        program = self.program
        if "64" not in str(command.dtype):
            raise ConfigurationError(
                f"planning takes numbers in double precision, got {command.dtype}"
            )
        problem = program.problem(state, command, stones, aim)
        xp, cost = namespace(command), program.cost(problem)
        least, _, greatest = program.variable(problem, problem.times).T
        variable = self._rest(cost, [], None)[0].clip(least, greatest)
        steps: list[Array] = []
        chosen, possible = [], []
        limits = program.limits
        if stones is not None:
            extra = program.weights.stay_of(problem, stones, limits.half_foot + limits.margin)
            if aim is not None:
                extra[:, 0] += program.weights.change_of(stones, aim)
        height, foothold, soonest = problem.stance[:, 2], problem.stance[:, :2], least
        reach = program.reach(problem)
        for k in range(program.steps):
            near = stones is None or k == 0
            # the motion that later stones need is not known yet: steps to them are the command's
            desired = self._rest(cost, steps, variable)[1][:, 0] if near else problem.step[:, k]
            box = self._box(problem, reach, steps, variable, of_body=near)
            if stones is None:
                step = _clipped(desired, *box)
                if shift is not None and k == 0:
                    step = _clipped(step + shift, *box)
            else:
                places = self._places(problem, stones, k, foothold, desired, box)
                places = (*places[:2], program.weights.step * places[2] + extra[:, k])
                stone, step, kept = self._choose(problem, stones, k, places, (foothold, height))
                height = stones.height(stone, height)
                possible.append(kept)
                chosen.append(stone)
            steps.append(step)
            foothold = foothold + step
            if k == 0:
                soonest = xp.maximum(least, self._soonest(problem, foothold, height))
                latest = xp.maximum(soonest, greatest)
                variable = self._rest(cost, steps, None)[0].clip(soonest, latest)
        if stones is not None:
            standing, pressed = stones.pick(xp.stack(chosen, -1)), problem
            for _ in range(_SWEEPS):
                variable, steps = self._improved(pressed, program.cost(pressed), standing, steps)
                variable = variable.clip(soonest, latest)
                distance = program.pressure(problem, variable, xp.stack(steps, 1))
                pressed = problem.pressed(distance)
            problem, cost = pressed, program.cost(pressed)
        taken = xp.stack(steps, 1)
        stone = xp.stack(chosen, -1) if chosen else 0 * problem.side - 1
        kept = xp.stack(possible, -1).cumprod(-1) if possible else 0 * problem.side + 1
        return Plan.of(
            program,
            problem,
            state,
            command,
            variable=variable,
            steps=taken,
            stones=stones,
            chosen=stone,
            on_stones=kept.sum(-1),
            within_limits=soonest <= greatest + _NONE,
            cost=program.value(cost, variable, taken),
        )

    def _improved(
        self, problem: Problem, cost: tuple[Array, ...], standing: Stones, steps: list[Array]
    ) -> tuple[Array, list[Array]]:
        """Optimal t (n,), and footholds that are each optimal on its stone with the others."""
        bend, cross, slope, slopes = cost[:4]
        xp, steps, matrix = namespace(slopes), [*steps], 2 * self.program.matrix
        variable = -(slope + (cross * xp.stack(steps, 1)).sum((-2, -1))) / bend
        pull = slopes + variable[:, None, None] * cross
        foothold, reach = problem.stance[:, :2], self.program.reach(problem)
        for k in range(len(steps)):
            # a foothold moves by what its step gets longer and the next one shorter
            move = np.eye(len(steps))[k] - np.eye(len(steps))[k + 1 : k + 2].sum(0)
            force = like(move @ matrix, slopes) @ xp.stack(steps, 1)
            force = force + (like(move, slopes)[:, None] * pull).sum(-2)
            desired = steps[k] - force / (move @ matrix @ move).item()
            box = self._box(problem, reach, steps[:k], variable)
            place = self._places(problem, standing.only(k), k, foothold, desired, box)[0][:, 0]
            if k + 1 < len(steps):
                steps[k + 1] = steps[k + 1] + steps[k] - place
            steps[k] = place
            foothold = foothold + place
        return variable, steps

    def _rest(
        self, cost: tuple[Array, ...], steps: list[Array], variable: Array | None
    ) -> tuple[Array, Array]:
        """Optimal t (n,), if it is not given, and remaining steps (n, N - k, 2) after k."""
        bend, cross, slope, slopes = cost[:4]
        k, matrix = len(steps), 2 * self.program.matrix
        inverse = like(np.linalg.inv(matrix[k:, k:]), slopes)
        rest = slopes[:, k:]
        if steps:
            taken = namespace(slopes).stack(steps, 1)
            rest = rest + like(matrix[k:, :k], slopes) @ taken
            slope = slope + (cross[:, :k] * taken).sum((-2, -1))
        at: Any = variable
        if variable is None:
            pull = inverse @ cross[:, k:]
            bend = bend - (pull * cross[:, k:]).sum((-2, -1))
            at = ((pull * rest).sum((-2, -1)) - slope) / bend
        return at, -(inverse @ (rest + at[:, None, None] * cross[:, k:]))

    def _box(
        self,
        problem: Problem,
        reach: tuple[Array, Array, Array],
        steps: list[Array],
        variable: Array,
        *,
        of_body: bool = True,
    ) -> tuple[Array, Array, Array]:
        """Directions ahead and outward (n, 2, 2), least and greatest next step (n, 2) along them.

        The reach of the body counts if asked for: where its motion is not known yet, it does not.

        Args:
            problem: programs.
            reach: see `Program.reach`.
            steps: steps before, (n, 2) each.
            variable: (n,) t.
            of_body: whether the reach counts.
        """
        limits, k = self.program.limits, len(steps)
        xp, axes = namespace(variable), problem.axes[:, k]
        constant, by_time, by_step = reach
        # the body from the next foothold, if the step were zero
        body = constant[:, k] + variable[:, None] * by_time[:, k]
        for j, step in enumerate(steps):
            body = body + by_step[k, j].item() * step
        body = xp.einsum("nij,nj->ni", axes, body)
        far, step = (
            [0 * body + like(np.array(one)[:, end], body) for end in (0, 1)]
            for one in ((limits.reach, limits.outward), (limits.length, limits.width))
        )
        if not of_body:
            return axes, *step
        low, high = xp.maximum(body + far[0], step[0]), xp.minimum(body + far[1], step[1])
        # where no step suits both, the leg that is nearer to its limit
        return axes, xp.minimum(low, step[1]), xp.maximum(xp.minimum(low, step[1]), high)

    def _places(
        self,
        problem: Problem,
        stones: Stones,
        k: int,
        foothold: Array,
        desired: Array,
        box: tuple[Array, Array, Array],
    ) -> tuple[Array, Array, Array]:
        """Nearest steps (n, m, 2) onto stones, their violations of the limits and costs (n, m)."""
        axes, low, high = box
        xp, limits = namespace(desired), self.program.limits
        heading, used = problem.heading[:, k : k + 1], self.program.used[k].item()
        offsets = stones.shrunk(heading, limits.half_foot, limits.margin, used)
        offsets = offsets[:, 0] - (stones.normals * foothold[:, None, None]).sum(-1)
        inside = nearest(
            _clipped(desired, *box)[:, None] + 0 * stones.centres, stones.normals, offsets
        )
        local = xp.einsum("nij,nmj->nmi", axes, inside)
        beyond = (low[:, None] - local).clip(0.0) + (local - high[:, None]).clip(0.0)
        return inside, (beyond**2).sum(-1), ((inside - desired[:, None]) ** 2).sum(-1)

    def _choose(
        self,
        problem: Problem,
        stones: Stones,
        k: int,
        places: tuple[Array, Array, Array],
        stance: tuple[Array, Array],
    ) -> tuple[Array, Array, Array]:
        """Index of the best stone (n,), step to it (n, 2), and whether it is possible (n,)."""
        (inside, violation, cost), (foothold, height) = places, stance
        xp = namespace(cost)
        rise = abs(stones.heights - height[:, None]) - self.program.limits.rise
        violation = violation + rise.clip(0.0) ** 2
        if k == 0:
            late = self._arrival(problem, foothold[:, None] + inside) - problem.times[:, 2:]
            violation = violation + (problem.fast[:, None] * late.clip(0.0)) ** 2
        cost = cost + _VIOLATION * violation
        best = xp.where(stones.present, cost, 0 * cost + np.inf).argmin(-1)
        rows = xp.arange(len(best), device=cost.device)
        return best, inside[rows, best], violation[rows, best] <= _NONE**2

    def _soonest(self, problem: Problem, foothold: Array, height: Array) -> Array:
        """Least t (n,) by which the foot can be at a foothold (n, 2)."""
        time = self._arrival(problem, foothold[:, None])
        down = self.program.least_time(problem, height[:, None])
        return self.program.variable(problem, namespace(time).maximum(time, down))[:, 0]

    def _arrival(self, problem: Problem, places: Array) -> Array:
        """Least times (n, m) until the swing foot can be at places (n, m, 2) [s]."""
        xp, fast = namespace(places), problem.fast[:, None]
        times = []
        for begin, place in problem.swings:
            way = places - place[:, None, :2]
            length = ((way**2).sum(-1) + 1e-12) ** 0.5
            speed = fast + (way * problem.velocity[:, None]).sum(-1) / length
            times.append(begin[:, None] + length / xp.maximum(speed, fast / 5))
        return xp.maximum(*times)


def _clipped(step: Array, axes: Array, low: Array, high: Array) -> Array:
    """Steps (n, 2) moved into boxes along axes."""
    xp = namespace(step)
    local = xp.einsum("nij,nj->ni", axes, step).clip(low, high)
    return xp.einsum("nij,ni->nj", axes, local)
