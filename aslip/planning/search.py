"""Branch and bound over the stones of one robot, with DAQP for the quadratic programs."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from math import isfinite

import daqp
import numpy as np

# DAQP's mark of a constraint that may be violated at a cost
_SOFT = 8
# stiffness of a displaced foothold [1/m^2]
_DRAWN = 1e5
# cost by which a node must be better [-]
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Programs:
    """Quadratic programs of n robots: cost x H x / 2 + f x + c, where low <= (x[0], A x) <= high.

    The variables x are t, the N steps and z, k of them.
    """

    hessian: np.ndarray
    """(n, k, k) H."""
    slope: np.ndarray
    """(n, k) f."""
    constant: np.ndarray
    """(n,) c."""
    matrix: np.ndarray
    """(n, r, k) A."""
    low: np.ndarray
    """(n, 1 + r)."""
    high: np.ndarray
    """(n, 1 + r)."""


@dataclass(frozen=True, eq=False)
class Choices:
    """Constraints and costs of m stones with e edges, for the programs of n robots."""

    near: np.ndarray
    """(n, m) bool, stones that can be reached in all steps."""
    normals: np.ndarray
    """(n, m, e, 2) normals of the edges."""
    offsets: np.ndarray
    """(n, N, m, e) of the parts that each step may use, from the stance foot [m]."""
    level: np.ndarray
    """(n, m + 1, m) bool, possible by height from one to the other; the stance foot comes first."""
    possible: np.ndarray
    """(n, N, m + 1, m) bool, possible from one to the other at each step."""
    stiffness: np.ndarray
    """(n, N, m, e) cost of footholds beyond an edge, at least [1/m^2]."""
    extra: np.ndarray
    """(n, N, m) cost of the stones themselves."""
    least: np.ndarray
    """(n, m) least t of a first step to a stone."""


@dataclass(frozen=True, eq=False)
class Found:
    """Optimum of a program, and the stones of its first steps."""

    variables: np.ndarray
    cost: float
    stones: tuple[int, ...] = ()
    within_limits: bool = True


class StoneSearch:
    """Branch and bound over the stones of one robot.

    Each node is a program in which the first steps have stones and the others are free, so that its
    cost is a lower bound.

    Args:
        programs: programs of robots.
        choices: their stones, or None for flat floor.
        robot: index of the robot.
    """

    def __init__(self, programs: Programs, choices: Choices | None, robot: int) -> None:
        self._hessian, self._slope = programs.hessian[robot], programs.slope[robot]
        self._constant, self._fixed = float(programs.constant[robot]), programs.low.shape[1]
        self._steps = programs.slope.shape[1] // 2 - 1
        self.nodes = 0
        """Programs solved."""
        self.kept = np.arange(0)
        """Stones that can be reached."""
        self._edges = 0
        if choices is not None:
            self.kept = np.flatnonzero(choices.near[robot])
            self._edges = choices.normals.shape[2]
            self._normals, self._offsets = choices.normals[robot], choices.offsets[robot]
            self._level, self._possible = choices.level[robot], choices.possible[robot]
            self._stiffness, self._extra = choices.stiffness[robot], choices.extra[robot]
            self._least = choices.least[robot]
            # a foothold is the sum of all steps to it
            self._repeated = np.tile(self._normals, self._steps)
        # the edges of the stones chosen so far follow the limits
        rows = self._fixed + self._steps * self._edges
        self._matrix = np.zeros((rows - 1, len(self._slope)))
        self._low, self._high = np.full(rows, -np.inf), np.empty(rows)
        self._matrix[: self._fixed - 1] = programs.matrix[robot]
        self._low[: self._fixed] = programs.low[robot]
        self._high[: self._fixed] = programs.high[robot]

    def best(self) -> Found:
        """Optimum, or the safest step."""
        self._best = Found(np.zeros(0), np.inf)
        root = self._solve(0)
        if root is None:
            return self._nearest(within_limits=False)
        if self._edges == 0:
            return Found(root[0], root[1] + self._constant)
        self._visit((), -1, root, 0.0)
        if not self._best.stones:
            return self._nearest(within_limits=True)
        return replace(self._best, cost=self._best.cost + self._constant)

    def moved(self, found: Found, shift: np.ndarray) -> Found:
        """Optimum on the floor with the next foothold moved by (2,), as far as limits allow [m]."""
        drawn, stiffness = copy(self), np.zeros_like(self._slope)
        stiffness[1:3] = _DRAWN
        drawn._hessian = self._hessian + np.diag(stiffness)
        drawn._slope = self._slope.copy()
        drawn._slope[1:3] -= _DRAWN * (found.variables[1:3] + shift)
        solved = drawn._solve(0)
        if solved is None:
            return found
        x = solved[0]
        cost = float(x @ self._hessian @ x / 2 + self._slope @ x) + self._constant
        return replace(found, variables=x, cost=cost)

    def cost(self, sequence: Sequence[int]) -> float:
        """Cost of a sequence of stones by index, as given; infinite if impossible."""
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
                self._best = Found(found[0], value[1], chosen)
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
        return (x, cost) if flag > 0 and isfinite(cost) else None

    def _nearest(self, *, within_limits: bool) -> Found:
        """Step that violates least: the edges of a stone, and the limits if they must."""
        # without stones, or if none has a solution, none is chosen
        best = self._solve(0, None if within_limits else 1)
        best = None if best is None else (best[0], np.inf if len(self.kept) else best[1])
        for i in self.kept:
            self._place(0, int(i))
            found = self._solve(1, self._fixed if within_limits else 1)
            if found is not None and (best is None or found[1] < best[1]):
                best = found
        if best is None:  # of a robot that falls: the foot stays where it is
            best = (np.zeros(len(self._hessian)), np.inf)
        return Found(best[0], best[1] + self._constant, (), within_limits)
