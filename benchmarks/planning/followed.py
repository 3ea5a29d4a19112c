"""Courses of stones that plans alone complete, which tells planners apart.

    python -m benchmarks.planning.followed

States go on from plan to plan without a robot, each policy step from where the last plan led. Noise
is added to the body's velocity at each policy step, and to the place of a foot at each touchdown.
A course is completed when the body is above the last stone, and lost when a foot lands beside all
stones or the body is 0.8 m from the stance foot.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    sizes: tuple[float, ...] = (0.2, 0.3)
    """Sides of the stones [m]."""
    difficulties: tuple[float, ...] = (0.0, 1.0)
    """Difficulties of random courses, see `aslip.sim.course.random_stones`."""
    noises: tuple[float, ...] = (0.0, 0.005, 0.01)
    """Standard deviations of the noise on each axis [m/s, m]."""
    courses: int = 24
    """Courses of each kind, at speeds from 0.3 to 0.8 m/s."""
    seconds: float = 40.0
    """Longest time on a course [s]."""
    seed: int = 0
    """Seed of courses and noise."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "seconds", courses=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from dataclasses import replace

import numpy as np
import torch

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.envs.straight import shipped_library
from aslip.planning import BatchPlanner, Planner, Stones
from aslip.robot import CASSIE
from aslip.robot.rotation import rotate_level
from aslip.sim.course import along_course, random_stones, stone_corners, stone_distances
from aslip.transforms.nested import mapped, to_numpy
from aslip.transforms.plan_state import start_state
from aslip.transforms.planned import default_planner

_SPEEDS = (0.3, 0.8)
# stones that a plan knows, and how far ahead of the body they are chosen [m]
_SEEN, _AHEAD = 8, 0.8
# change of the command in a policy step, and distance of the body at which it has fallen [m]
_RATE, _FALLEN = 0.02, 0.8


def followed(
    planner: Planner | BatchPlanner, stones: np.ndarray, noise: float, config: Config
) -> np.ndarray:
    """Whether each course (n, s, 6) is completed, (n,) bool."""
    rng, num = np.random.default_rng(config.seed), len(stones)
    speed = torch.linspace(*_SPEEDS, num)[:, None]
    command = torch.cat([speed, 0 * speed, 0 * speed], 1)
    zero = torch.zeros(num, 1)
    start = start_state(shipped_library("directions"), zero, command, 0 * command, zero)
    state = mapped(to_numpy, start)
    command, pace = command.double().numpy(), speed.double().numpy()
    place, yaw = np.zeros((num, 2)), np.zeros(num)
    aim, rows = np.full((num, 3), np.nan), np.arange(num)
    going, done = np.ones(num, dtype=bool), np.zeros(num, dtype=bool)
    corners = stone_corners(stones)
    for _ in range(round(config.seconds / CASSIE.policy_period)):
        known = _nearest(stones, place + _AHEAD * np.stack([np.cos(yaw), np.sin(yaw)], -1))
        seen = Stones.from_corners(
            rotate_level(corners[rows[:, None], known] - place[:, None, None], -yaw[:, None, None]),
            stones[rows[:, None], known, 2],
        )
        wanted = along_course(stones, place, yaw[:, None], pace)
        command = command + (wanted - command).clip(-_RATE, _RATE)
        plan = planner.plan(state, command, seen, aim=aim)
        later = plan.sample(np.full(num, CASSIE.policy_period)).state()
        lands = later.stance != state.stance
        feet, velocity = later.foot_position.copy(), later.body_velocity.copy()
        feet[rows, later.stance, :2] += lands[:, None] * noise * rng.normal(size=(num, 2))
        velocity[:, :2] += noise * rng.normal(size=(num, 2))
        later = replace(later, foot_position=feet, body_velocity=velocity)
        stood = feet[rows, later.stance, :2]
        beside = (
            stone_distances(stones, (place + rotate_level(stood, yaw))[:, None])[:, 0].min(-1) > 0
        )
        far = np.abs(later.body_position[:, :2] - stood).max(-1) > _FALLEN
        going &= ~(lands & beside) & ~far
        # the next frame is below the body
        moved, turn = later.body_position[:, :2], command[:, 2] * CASSIE.policy_period
        flies = (later.since > planner.program.pendulum.double_stance) & ~lands
        aim = rotate_level(plan.foothold[:, 0, :2] - moved, -turn)
        aim = np.concatenate([aim, plan.time[:, :1] - CASSIE.policy_period], 1)
        aim = np.where(flies[:, None], aim, np.nan)
        state = later.seen_from(moved, turn)
        place, yaw = place + rotate_level(moved, yaw), yaw + turn
        there = stone_distances(stones[:, -1:], place[:, None])[:, 0, 0] == 0
        done, going = done | (going & there), going & ~there
        if not going.any():
            break
    return done


def main(config: Config) -> None:
    """Follow plans over all courses, and print the table."""
    exact, rows = default_planner(), []
    planners = {"exact": exact, "batched": BatchPlanner(exact.program)}
    for name, planner in planners.items():
        for size in config.sizes:
            for difficulty in config.difficulties:
                rng = np.random.default_rng(config.seed)
                stones = random_stones(rng, config.courses, size=size, difficulty=difficulty)
                for noise in config.noises:
                    done = followed(planner, stones, noise, config)
                    share = Interval.of_share(int(done.sum()), len(done))
                    rows.append(
                        [name, f"{size:g}", f"{difficulty:g}", f"{noise:g}", share.text(0, 100)]
                    )
    header = ["planner", "stones [m]", "difficulty", "noise [m/s, m]", "completed [%]"]
    print(markdown(header, rows, ["---", *["---:"] * 4]))


def _nearest(stones: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Indices (n, k) of the stones nearest to points (n, 2), in the order of the course."""
    distance = stone_distances(stones, points[:, None])[:, 0]
    return np.sort(np.argsort(distance, -1)[:, :_SEEN], -1)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
