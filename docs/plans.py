"""Draw the picture of the page of the planner: a walk, a push and stones, by plans alone.

python -m docs.plans
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Polygon

from aslip.planning import Plan, Planner, Stones, WalkState
from benchmarks.planning.planner import standing

_COMMAND = np.array([[0.6, 0.0, 0.0]])
# time of the push after a touchdown [s], and speed that it adds [m/s]
_PUSHED, _PUSH = 0.15, np.array([0.0, 0.35, 0.0])
_LEFT, _RIGHT, _BODY, _OFFSET, _STONE = "#1f77b4", "#d2780f", "#222222", "#8e5bb5", "#cfcfcf"


def walking(planner: Planner) -> WalkState:
    """State at a touchdown of the left foot, after plans from a stance at rest."""
    state = standing(planner.program, 0)
    for _ in range(12):
        plan = planner.plan(state, _COMMAND)
        state = plan.sample(plan.time[:, 0]).state()
    return state.seen_from(state.of_foot(state.foot_position, swing=False)[:, :2], np.zeros(1))


def motion(plan: Plan, rate: float) -> dict[str, Any]:
    """Body, divergent component and time until the third touchdown."""
    time = np.arange(0.0, plan.time[0, 2], 0.005)
    body = plan.sample(time).body
    ahead = body.position + body.velocity / rate
    return {"time": time, "body": body.position[:, :2], "component": ahead[:, :2]}


def feet_of(axes: Any, plan: Plan, *, filled: bool = True) -> None:
    """Draw the footholds, with their times."""
    side = (plan.state.stance[0] + 1 + np.arange(plan.foothold.shape[1])) % 2
    for k, (x, y, _) in enumerate(plan.foothold[0, :3]):
        colour = (_LEFT, _RIGHT)[side[k]]
        axes.plot(x, y, "s", ms=11, mec=colour, mfc=colour if filled else "none", alpha=0.8)
        if filled:
            axes.text(x, y + 0.05, f"{plan.time[0, k]:.2f} s", fontsize=8, ha="center")


def main(path: Path) -> None:
    """Draw and write."""
    planner = Planner()
    rate, start = planner.program.pendulum.rate, walking(planner)
    calm = planner.plan(start, _COMMAND)
    figure, (over, pushed, stepped) = plt.subplots(
        1, 3, figsize=(12.5, 3.5), layout="constrained", width_ratios=[1, 1.15, 1.15]
    )

    found = motion(calm, rate)
    over.plot(found["time"], found["component"][:, 1], color=_OFFSET, label="divergent component")
    over.plot(found["time"], found["body"][:, 1], color=_BODY, label="body")
    stood = [start.foot_position[0, 0, 1], *calm.foothold[0, :2, 1]]
    for k, (begin, place) in enumerate(zip([0.0, *calm.time[0, :2]], stood, strict=True)):
        colour, label = ((_LEFT, "left foot"), (_RIGHT, "right foot"))[k % 2]
        ends = [begin, calm.time[0, k]]
        over.plot(ends, [place] * 2, color=colour, lw=4, label=label if k < 2 else None)
    over.set(
        xlabel="time [s]",
        ylabel="to the left [m]",
        title="a walk straight ahead",
        ylim=(-0.31, 0.02),
    )
    over.legend(fontsize=8, loc="lower center", ncols=2)

    state = calm.sample(np.array([_PUSHED])).state()
    after = planner.plan(replace(state, body_velocity=state.body_velocity + _PUSH), _COMMAND)
    before = planner.plan(state, _COMMAND)
    for plan, line in ((before, ":"), (after, "-")):
        found = motion(plan, rate)
        pushed.plot(*found["body"].T, line, color=_BODY)
        pushed.plot(*found["component"].T, line, color=_OFFSET, lw=1)
        feet_of(pushed, plan, filled=line == "-")
    pushed.plot(*state.foot_position[0, 0, :2], "s", ms=11, color=_BODY, alpha=0.4)
    pushed.set(xlabel="ahead [m]", title="pushed to the left by 0.35 m/s (dotted: not)")

    places = np.array([[0, 0], [0.36, -0.3], [0.42, 0.05], [0.75, 0.1], [0.8, -0.25], [1.2, -0.1]])
    places = start.foot_position[0, 0, :2] + places
    square = 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    plan = planner.plan(start, _COMMAND, Stones.of([square + p for p in places], [0.0] * 6))
    for place in places:
        stepped.add_patch(Polygon(square + place, fc=_STONE, ec="none"))
    found = motion(plan, rate)
    stepped.plot(*found["body"].T, color=_BODY)
    stepped.plot(*found["component"].T, color=_OFFSET, lw=1)
    feet_of(stepped, plan)
    stepped.set(xlabel="ahead [m]", title="on stones of 20 cm")
    for axes in (pushed, stepped):
        axes.set_aspect("equal", adjustable="datalim")
    for axes in (over, pushed, stepped):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    plt.switch_backend("agg")
    main(Path(__file__).parent / "images" / "plans.png")
