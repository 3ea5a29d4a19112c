"""Exact plans against brute force over stones, their time, and the batched plans against them.

    python -m benchmarks.planning.planner

Problems are states near a walk, disturbed, with stones near its next footholds. Time is CPU time
of one robot. The batched planner is compared where all steps of the exact plan are on stones.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    problems: int = 1000
    """Number of random problems."""
    stones: int = 4
    """Number of stones of each."""
    seed: int = 0
    """Seed of the problems."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
import time

import numpy as np

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.planning import BatchPlanner, Planner, Program, Stones, WalkState
from aslip.planning.search import StoneSearch


@dataclass(frozen=True)
class Case:
    """Problem of one robot."""

    state: WalkState
    command: np.ndarray
    stones: Stones


def random_case(program: Program, rng: np.random.Generator, stones: int = 4) -> Case:
    """Disturbed state of a walk at a random command and time, and stones near its footholds."""
    stance, since = int(rng.integers(2)), rng.uniform(0.0, 0.3)
    command = np.array([[*rng.uniform([-0.2, -0.2, -0.4], [1.0, 0.2, 0.4])]])
    # the walk's state at its last touchdown, from a state there
    start = standing(program, stance)
    problem = program.problem(start, command)
    side = -problem.side[0, 0]
    offset = program.periodic(command, np.zeros((1, 1)), np.array([[side]]))
    step, divergent = offset[0][0, 0], offset[1][0, 0]
    velocity = command[0, :2] + np.array([0.0, 0.5 * program.width * side * program.pendulum.rate])
    place = divergent - velocity / program.pendulum.rate
    velocity = velocity + rng.normal(0, 0.05, 2)
    last = np.array([*-step, 0.0])
    feet = np.zeros((1, 2, 3))
    feet[0, 1 - stance] = last
    state = WalkState(
        body_position=np.array([[*place, program.pendulum.height]]),
        body_velocity=np.array([[*velocity, 0.0]]),
        foot_position=feet,
        foot_velocity=np.zeros((1, 2, 3)),
        foot_acceleration=np.zeros((1, 2, 3)),
        foot_heading=np.zeros((1, 2)),
        lift_off=last[None],
        stance=np.array([stance]),
        since=np.zeros(1),
    )
    plan = Planner(program).plan(state, command)
    state = plan.sample(np.array([since])).state()
    places = np.concatenate([plan.foothold[0], plan.foothold[0]])[:stones, :2]
    polygons = [random_polygon(rng, place + rng.normal(0, 0.1, 2)) for place in places]
    return Case(state, command, Stones.of(polygons, rng.uniform(-0.08, 0.08, stones).tolist()))


def standing(program: Program, stance: int) -> WalkState:
    """State at rest above the origin, just after a touchdown there."""
    flat = np.zeros((1, 2, 3))
    body = np.array([[0.0, 0.0, program.pendulum.height]])
    return WalkState(
        body_position=body,
        body_velocity=0 * body,
        foot_position=flat,
        foot_velocity=flat,
        foot_acceleration=flat,
        foot_heading=np.zeros((1, 2)),
        lift_off=0 * body,
        stance=np.array([stance]),
        since=np.zeros(1),
    )


def random_polygon(rng: np.random.Generator, place: np.ndarray) -> np.ndarray:
    """Convex polygon of three to six corners around a place."""
    corners = int(rng.integers(3, 7))
    angle = (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) * (2 * np.pi / corners)
    size = rng.uniform(0.12, 0.25)
    return place + size * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def search(planner: Planner, case: Case) -> StoneSearch:
    """Search of a case."""
    problem = planner.program.problem(case.state, case.command, case.stones)
    return planner.searches(problem, case.stones)[0]


def brute_force(planner: Planner, case: Case) -> float:
    """Least cost over all sequences of stones; infinite if none is possible."""
    found = search(planner, case)
    sequences = itertools.product(found.kept.tolist(), repeat=planner.program.steps)
    return min((found.cost(sequence) for sequence in sequences), default=np.inf)


def main(config: Config) -> None:
    """Measure and print."""
    planner = Planner()
    rng = np.random.default_rng(config.seed)
    cases = [random_case(planner.program, rng, config.stones) for _ in range(config.problems)]
    batch = BatchPlanner(planner.program)
    worst, possible, rows, seconds, nodes = 0.0, 0, [], [], []
    for case in cases:
        least = brute_force(planner, case)
        start = time.process_time()
        plan = planner.plan(case.state, case.command, case.stones)
        seconds.append(time.process_time() - start)
        found = search(planner, case)
        found.best()
        nodes.append(found.nodes)
        complete = plan.on_stones[0] == planner.program.steps
        assert complete == np.isfinite(least), "branch and bound and brute force differ"
        if complete:
            possible += 1
            worst = max(worst, abs(float(plan.cost[0]) - least))
            rough = batch.plan(case.state, case.command, case.stones)
            gap = np.linalg.norm((rough.foothold - plan.foothold)[0, 0, :2])
            late = abs(rough.time[0, 0] - plan.time[0, 0])
            same = rough.stones[0, 0] == plan.stones[0, 0]
            rows.append((gap, late, same))
    gaps, lates, sames = np.array(rows, dtype=float).T
    times = np.array(seconds)
    table = {
        "problems, with all steps on stones": f"{len(cases)}, {possible}",
        "largest difference of cost from brute force": f"{worst:.1e}",
        "time of a plan, median, p99 [ms]": "{:.2f}, {:.2f}".format(
            *1e3 * np.quantile(times, (0.5, 0.99))
        ),
        "programs solved, median, most": f"{np.median(nodes):.0f}, {max(nodes)}",
        "batched planner: same next stone [%]": Interval.of_share(int(sames.sum()), possible).text(
            1, 100.0
        ),
        "foothold, median, p95 [cm]": "{:.1f}, {:.1f}".format(
            *1e2 * np.quantile(gaps, (0.5, 0.95))
        ),
        "touchdown, median, p95 [ms]": "{:.1f}, {:.1f}".format(
            *1e3 * np.quantile(lates, (0.5, 0.95))
        ),
    }
    print(markdown(["", "result"], [[name, value] for name, value in table.items()]))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
