"""Walks over courses of stones: random ones, the eight patterns, stairs, and stones that vanish.

    python -m benchmarks.planning.stepping_stones

Each robot of a batch walks another course, at a random speed and phase, led along the course's
middle. A course is completed when the pelvis is above the last stone. A stone is left when the
robot falls, or a loaded foot is deeper than a stone's top. Stacks with a planner, which writes
`("plan", ...)`, see the stones; others walk blindly.

With `--planner`, robots of any policy have another planner:

- `exact`, the default of stacks with one;
- `nearest`, which chooses stones one after another, for all robots at once;
- `two`, with a foresight of two steps;
- `fixed`, with touchdowns every 0.4 s.

In the row of vanishing stones, these lie in pairs, left and right, close behind each other, and the
one to which a foot in flight goes is taken away at once. It counts how many walk on, or stand,
without leaving the others.

Touchdowns are compared with the last plan of that foot before them: distance of its centre from the
foothold, and time. The simulator gives contacts for whole policy steps, so the time within a step
is that in which the foot falls to the stone at its last speed.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import UnknownNameError, one_line_errors
from benchmarks.flags import Directions, check_numbers

PLANNERS = ("exact", "nearest", "two", "fixed")
"""Names of planners to compare."""


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    planner: str | None = None
    """One of `PLANNERS`, in the place of that of the policy's stack."""

    difficulties: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    """Difficulties of random courses, see `aslip.sim.course.random_stones`."""
    patterns: tuple[str, ...] = (
        "straight", "narrow", "wide", "zigzag", "alternating", "up", "down", "mixed",
    )  # fmt: skip
    """Patterns of courses, see `aslip.sim.course.PATTERNS`."""
    stairs: tuple[float, ...] = (0.1, -0.1, 0.15, -0.15)
    """Heights of the steps of stairs [m]; negative ones lead down."""
    vanishing: bool = True
    """Whether there are walks in which a stone vanishes; they need a planner."""
    trials: int = 100
    """Walks of each kind of course."""
    count: int = 20
    """Stones between the platforms."""
    size: float = 0.2
    """Side of a stone [m]."""
    slowest: float = 0.3
    """Least speed [m/s]."""
    fastest: float = 0.8
    """Greatest speed [m/s]."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_numbers(self, "slowest", trials=1, fastest=self.slowest)
        if self.planner not in (None, *PLANNERS):
            raise UnknownNameError.among("planner", self.planner, PLANNERS)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from matplotlib.figure import Figure
from tensordict import TensorDict, TensorDictBase
from tqdm import tqdm

import aslip
from aslip.base.interval import Interval
from aslip.envs import StackEnv
from aslip.envs.directions import planned_stack
from aslip.planning import BatchPlanner, Planner, Program
from aslip.robot import CASSIE, SIDES
from aslip.robot.rotation import yaw
from aslip.show.palette import ROBOT
from aslip.sim.course import (
    along_course,
    ground_height,
    lay_stones,
    pattern,
    random_stones,
    stairs,
    stone_distances,
)
from aslip.transforms import DIRECTION_TABLE, AssembleObservation, RandomCourse, SeenStones
from aslip.transforms.observation import planned_table
from aslip.transforms.plan_state import footholds_in_world, landing_foot
from aslip.transforms.planned import default_planner
from aslip.transforms.stones import COURSE_KEY
from aslip.walking import next_start
from aslip.walking.record import can_stand, commands_kept, take_step
from benchmarks.common import Policies, Report, Subject, benchmark, insert_before_plan, table

# a loaded foot this far below the stones has left them [m]
_DEEP = 0.05
# load of a foot that has landed [N], and policy steps by which it may be late
_LANDED, _LATEST = 50.0, 6
# row of stones that vanish, and distance of rows of two, left and right [m]
_VANISHING, _CLOSE = "vanishing", 0.22
# the first that may vanish, time until the touchdown then, and that of the walk after it [s]
_THIRD, _LEFT, _AFTER = 3, (0.12, 0.2), 4.0
# times for a course, in multiples of that at the commanded speed and beyond it [s]
_PATIENCE, _START = 1.5, 5.0


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Walk, compare and draw; the result is the rows."""
    courses = courses_of(config)
    subjects = [with_planner(subject, config.planner) for subject in policies.load()]
    walks: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in courses}
    with tqdm(total=len(subjects) * len(courses), unit="course", leave=False) as bar:
        for subject in subjects:
            with closing(environment(config, subject, courses)) as env, commands_kept(env):
                for name, stones in courses.items():
                    vanishes = name == _VANISHING
                    if not vanishes or "plan" in env.observation_spec:
                        walks[name].append(walk_courses(config, subject, env, stones, vanishes))
                    bar.update()
    rows = [{"course": name, **row_of(results)} for name, results in walks.items() if results]
    numbers = {"planner": config.planner, "rows": rows}
    return Report(rows, table(COLUMNS, rows), picture(config, rows), numbers)


def courses_of(config: Config) -> dict[str, np.ndarray]:
    """Stones (trials, s, 6) by the names of rows."""
    rng, shape = np.random.default_rng(config.seed), {"count": config.count, "size": config.size}
    courses = {
        f"{difficulty:g}": random_stones(rng, config.trials, difficulty=difficulty, **shape)
        for difficulty in config.difficulties
    }
    for name in config.patterns:
        courses[name] = np.repeat(pattern(name, **shape).stones[None], config.trials, 0)
    for rise in config.stairs:
        flight = stairs(rise, steps=config.count + 1).stones
        courses[f"stairs {rise:+g} m"] = np.repeat(flight[None], config.trials, 0)
    if config.vanishing:
        rows = lay_stones(np.resize([_CLOSE, 0.0], config.count), size=config.size)
        courses[_VANISHING] = np.repeat(rows[None], config.trials, 0)
    return courses


def with_planner(subject: Subject, name: str | None) -> Subject:
    """Subject whose robots have one of `PLANNERS`, or its own for None."""
    if name is None:
        return subject
    exact = default_planner()
    pendulum, limits = exact.program.pendulum, exact.program.limits
    fixed = (0.99 * pendulum.step_time, 1.01 * pendulum.step_time)
    planners = {
        "exact": exact,
        "nearest": BatchPlanner(exact.program),
        "two": Planner(Program(pendulum, steps=2)),
        "fixed": Planner(Program(pendulum, replace(limits, step_time=fixed))),
    }
    stack = planned_stack(subject.library, planner=planners[name])
    if getattr(subject.policy, "card", {}).get("stack") != "planned":
        stack["observation"] = AssembleObservation(planned_table(DIRECTION_TABLE))
    return replace(subject, make_env=partial(aslip.make_env, stack=stack))


def environment(config: Config, subject: Subject, courses: dict[str, np.ndarray]) -> StackEnv:
    """Environment whose planner sees the stones, if it has one."""
    env = subject.walking_env(config, config.trials)
    if "plan" in env.observation_spec and "stones" not in env.observation_spec:
        insert_before_plan(env, RandomCourse(next(iter(courses.values()))), SeenStones())
    return env


# ---------------------------------------------------------------------------- walks


def walk_courses(
    config: Config, subject: Subject, env: StackEnv, stones: np.ndarray, vanishing: bool = False
) -> dict[str, np.ndarray]:
    """Walk over stones (n, s, 6): (n,) `completed`, and `distance` and `late` of touchdowns.

    With `vanishing`, a walk is completed a while after one of its stones has vanished.
    """
    num, rng = len(stones), np.random.default_rng(config.seed)
    speed = rng.uniform(config.slowest, config.fastest, num)
    request = {
        "command": torch.zeros(num, subject.library.command_size),
        "phase": torch.as_tensor(rng.random((num, 1)), dtype=torch.float32),
        "course": TensorDict(stones=torch.as_tensor(stones, dtype=torch.float32)),
    }
    request["command"][:, 0] = torch.as_tensor(speed)
    if can_stand(env):
        request["stand"] = torch.zeros(num, 1)
    td = env.reset(TensorDict(request, batch_size=num, device=env.device))
    length = np.linalg.norm(np.diff(stones[..., :2], axis=1), axis=-1).sum(-1)
    steps = int((_PATIENCE * length / speed + _START).max() / CASSIE.policy_period)
    walking, completed = np.ones(num, dtype=bool), np.zeros(num, dtype=bool)
    frames = [frame_of(td, stones, walking)]
    places, speeds = torch.as_tensor(stones), torch.as_tensor(speed)[:, None]
    stones, lost = stones.copy(), np.full(num, steps)
    first = rng.integers(_THIRD, max(stones.shape[1] // 2, _THIRD + 1), num)
    for step in range(steps):
        if vanishing:
            first = np.where(walking & (lost == steps), first, stones.shape[1])
            lost[take_stones(env, td, stones, first)] = step
        pose = [torch.as_tensor(frames[-1][name]) for name in ("pelvis", "yaw")]
        command = along_course(places, pose[0], pose[1][:, None], speeds)
        td["command"] = subject.library.nearest(command.float()).to(td["command"])
        after = take_step(subject.policy, env, td)
        outcome = cast("TensorDictBase", after["next"])
        frame = frame_of(outcome, stones, walking)
        walking = walking & ~(frame["left"] | outcome["terminated"][:, 0].cpu().numpy())
        goal = stone_distances(stones[:, -1:], frame["pelvis"][:, None])[:, 0, 0] == 0
        if vanishing:
            goal = (lost < steps) & (goal | ((step - lost) * CASSIE.policy_period > _AFTER))
        completed |= walking & goal
        walking = walking & ~completed
        frames.append(frame)
        if not walking.any():
            break
        td = next_start(after)
    seen = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    return {"completed": completed, **touchdowns(seen)}


def take_stones(
    env: StackEnv, td: TensorDictBase, stones: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """Take away the stones (n, s, 6) to which feet in flight go, in place.

    Args:
        env: environment.
        td: entries of its robots.
        stones: their stones.
        first: (n,) index of the first stone that may be taken from each.

    Returns:
        Indices of the robots that have lost one.
    """
    left = cast("torch.Tensor", td["plan", "time"])[:, 0].cpu().numpy()
    aim = footholds_in_world(td)[:, :1, :2].double().cpu().numpy()
    nearest = stone_distances(stones, aim)[:, 0].argmin(-1)
    rows = np.flatnonzero((nearest >= first) & (left > _LEFT[0]) & (left < _LEFT[1]))
    if len(rows):
        stones[rows, nearest[rows]] = np.nan
        env.base_env.set_stones(stones)
        td[COURSE_KEY] = torch.as_tensor(stones, dtype=torch.float32, device=td.device)
    return rows


def frame_of(td: TensorDictBase, stones: np.ndarray, walking: np.ndarray) -> dict[str, np.ndarray]:
    """Numbers to compare at the end of a policy step; footholds in the world, NaN without plan."""
    truth = {name: value.double().cpu().numpy() for name, value in td["truth"].items()}
    feet = np.stack([truth[f"{side}_foot_position"] for side in SIDES], axis=1)
    load, pelvis = truth["ground_force"][..., 2], truth["pelvis_position"][:, :2]
    below = [ground_height(stones, feet[:, [i, i], :2], load)[:, 0] for i in range(2)]
    height = feet[..., 2] - np.stack(below, axis=1)
    turn, plan = yaw(truth["pelvis_orientation"]), np.full((len(load), 3), np.nan)
    foot = np.zeros(len(load), dtype=int)
    if "plan" in td.keys():  # noqa: SIM118
        foot = landing_foot(td).cpu().numpy()
        plan[:, :2] = footholds_in_world(td)[:, 0, :2].cpu().numpy()
        plan[:, 2] = td["plan", "time"][:, 0].double().cpu().numpy()
    return {
        "pelvis": pelvis,
        "yaw": turn,
        "feet": feet[..., :2],
        "height": height,
        "sinking": -np.stack([truth[f"{side}_foot_velocity"][:, 2] for side in SIDES], axis=1),
        "load": load,
        "left": np.any((load > 0) & (height < -_DEEP), axis=1),
        "plan": plan,
        "foot": foot,
        "walking": walking,
    }


def touchdowns(seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Distances [m] and differences of time [s] of touchdowns (k,) from the plans before them.

    Args:
        seen: what `frame_of` gives, by policy step (m, n, ...).
    """
    load, height, plan = seen["load"], seen["height"], seen["plan"]
    lands = (load[:-2] == 0) & (load[1:-1] > 0) & (load[2:] > _LANDED)
    lands &= seen["walking"][2:, :, None]
    at, robot, foot = np.nonzero(lands)
    fall = np.maximum(height[at, robot, foot], 0.0)
    fall = fall / np.maximum(seen["sinking"][at, robot, foot], 1e-3)
    time = np.minimum(fall, CASSIE.policy_period)
    # a foot that lands late does so when the plan is already about the other one
    last = at.copy()
    for _ in range(_LATEST):
        last -= (seen["foot"][last, robot] != foot) & (last > 0)
    planned = np.where((seen["foot"][last, robot] == foot)[:, None], plan[last, robot], np.nan)
    distance = np.linalg.norm(seen["feet"][at + 1, robot, foot] - planned[:, :2], axis=-1)
    time = time + (at - last) * CASSIE.policy_period
    return {"distance": distance, "late": time - planned[:, 2]}


# --------------------------------------------------------------------------- report


def row_of(results: list[dict[str, np.ndarray]]) -> dict[str, Any]:
    """Row of a difficulty or pattern; its interval is Wilson's of one policy, Student's of more."""
    completed = [result["completed"].astype(float) for result in results]
    share = Interval.of(completed)
    if len(completed) == 1:
        share = Interval.of_share(int(completed[0].sum()), len(completed[0]))
    distance, late = (
        np.concatenate([result[name] for result in results]) for name in ("distance", "late")
    )
    known = np.isfinite(distance)
    distance, late = distance[known], np.abs(late[known])
    return {
        **vars(share),
        "trials": sum(map(len, completed)),
        "touchdowns": len(distance),
        "distance": float(distance.mean()) if known.any() else np.nan,
        "distance_p95": float(np.quantile(distance, 0.95)) if known.any() else np.nan,
        "late": float(late.mean()) if known.any() else np.nan,
    }


COLUMNS = {
    "course": "{course}",
    "completed [%]": lambda row: Interval.of_row(row).text(1, 100),
    "walks": "{trials}",
    "touchdowns": "{touchdowns}",
    "foot from plan, mean, p95 [cm]": lambda row: (
        f"{100 * row['distance']:.1f}, {100 * row['distance_p95']:.1f}"
        if row["touchdowns"]
        else "-"
    ),
    "touchdown from plan, mean [ms]": lambda row: (
        f"{1e3 * row['late']:.0f}" if row["touchdowns"] else "-"
    ),
}
"""Columns of the table: random courses by difficulty, then patterns and stairs."""


def picture(config: Config, rows: list[dict[str, Any]]) -> Figure:
    """Draw success and distances over difficulty, and success on the other courses."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    panels = figure.subplots(1, 3)
    mean, low, high = (100 * np.array([row[k] for row in rows]) for k in ("mean", "low", "high"))
    spread, hard = [mean - low, high - mean], len(config.difficulties)
    style = {"color": ROBOT, "ms": 4, "capsize": 3}
    panels[0].errorbar(
        config.difficulties, mean[:hard], [x[:hard] for x in spread], fmt="o-", **style
    )
    panels[0].set(xlabel="difficulty", ylabel="courses completed [%]", ylim=(-4, 104))
    for name, line in {"distance": "o-", "distance_p95": "o--"}.items():
        values = [100 * row[name] for row in rows[:hard]]
        label = "95 % quantile" if "95" in name else "mean"
        panels[1].plot(config.difficulties, values, line, color=ROBOT, ms=4, label=label)
    panels[1].set(xlabel="difficulty", ylabel="foot from its foothold [cm]")
    panels[1].legend(fontsize=8)
    names = [row["course"] for row in rows[hard:]]
    panels[2].errorbar(names, mean[hard:], [x[hard:] for x in spread], fmt="o", **style)
    panels[2].set(ylabel="courses completed [%]", ylim=(-4, 104))
    panels[2].tick_params(axis="x", rotation=90)
    for axes in panels:
        axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
