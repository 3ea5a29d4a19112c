"""Teach Cassie to step where a planner says, on stones and on the floor.

    python recipes/stepping_stones.py              # train, evaluate, draw: runs/stepping_stones/
    python recipes/stepping_stones.py --resume     # continue after Ctrl-C, kill or a crash
    python recipes/walk.py --policy runs/stepping_stones --course 7 --command "0.5 0 0"

A planner on a linear pendulum decides at every policy step where and when the next feet land, and
the policy follows. It goes on from the policy of all directions, which has never seen a plan: that
stays as it is for robots that follow the library, and a copy learns to follow plans. Some robots of
a batch walk over random courses of stones and fall into the gaps; the others are on the floor,
where footholds are displaced at random, also in flight. Robots, pushes and PPO are those of
`ppo_directions.py`; evaluations walk commands on the floor, on plans.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ppo_direction_settings import DirectionConfig
from ppo_settings import ON_GPU, resume_command, training_settings, with_schedule

from aslip.errors import ConfigurationError, one_line_errors
from aslip.training.settings import check_range


@dataclass(frozen=True)
class StonesConfig(DirectionConfig):
    """Settings of learning, and of the robots and courses to learn on."""

    out: Path = Path("runs/stepping_stones")
    """Folder of the run."""
    start: str | None = "directions"
    """Policy to start from, which acts for robots without stones: the name of a shipped one, a file
    or a run."""
    total_steps: int = 6_000_000
    """Policy steps to train for, rounded up to whole updates."""
    samples: int = 8192
    """Policy steps per update."""
    minibatch: int = 1024
    """Samples per gradient step."""
    learning_rate: float = 1e-4
    """Initial learning rate of Adam."""
    last_learning_rate: float = 1e-5
    """Final learning rate of Adam."""
    std: float = 0.07
    """Initial standard deviation of the policy [rad]."""
    last_std: float = 0.03
    """Final standard deviation of the policy [rad]."""
    push_impulse: float = 10.0
    """Largest impulse of random pushes [N s]; 0 for none."""
    stand: float = 0.05
    """Share of the time with a stand command; 0 for robots that only walk."""
    command_interval: float = 3.0
    """Mean time between changes of the command in an episode [s]."""
    ramp: float = 0.3
    """Share of the training over which displaced footholds, ranges and pushes grow."""
    courses: float = 0.75
    """Share of the episodes with stones."""
    supported: float = 0.5
    """Share of these in which the ground between the stones does not let robots fall."""
    footstep_ahead: float = 0.1
    """Standard deviation of the displacement of footholds ahead [m]."""
    footstep_sideways: float = 0.05
    """Standard deviation of their displacement sideways [m]."""
    eval_interval: int = 500_000
    """Policy steps between evaluations."""

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            ConfigurationError: a setting is invalid.
        """
        super().__post_init__()
        if self.start is None:
            raise ConfigurationError(
                "start must be a policy, which acts for robots without stones, got None"
            )
        check_range(self, 0, 1, "courses", "supported")


PRESETS = {
    "default": StonesConfig(),
    "gpu": StonesConfig(
        preset="gpu",
        out=Path("runs/stepping_stones_gpu"),
        total_steps=25_000_000,
        **{**ON_GPU, "learning_rate": 3e-4, "last_learning_rate": 3e-5},
    ),
}
"""Settings to start from, by name."""

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(PRESETS)

from functools import partial
from typing import cast

import numpy as np
import ppo_directions

from aslip.envs import Stack, insert_before
from aslip.envs.directions import course_stack, planned_stack
from aslip.library import GaitLibrary
from aslip.planning import BatchPlanner
from aslip.policy import make_planned_actor
from aslip.sim.course import LEAST_GAP, lay_stones, random_stones
from aslip.training.settings import read_settings
from aslip.transforms import CourseCommand, RandomFootsteps
from aslip.transforms.planned import default_planner
from aslip.walking import WalkResult

# speeds on stones, whose distance sets the pace [m/s]
_SPEEDS = (0.35, 0.95)
# sides of stones [m], difficulties, of which the hardest counts twice, courses of each, stones of a
# course, and seed of them all
_SIZES, _DIFFICULTIES, _EACH, _COUNT, _SEED = (0.2, 0.3), (0.5, 1.0, 1.0), 400, 16, 77
# length of steps, distance of the feet and rise of a step of varied courses, at least and most [m]
_LEAST, _MOST = (0.22, 0.14, -0.12), (0.55, 0.4, 0.12)
# differences of single steps in length and rise [m], largest turn from straight ahead [rad], and
# stones until the next
_DIFFERENCES, _TURN, _STRAIGHT = (0.12, 0.05), 0.45, 4
# shares of the varied courses that turn, and that are stairs
_TURNS, _STAIRS = 0.4, 0.25
# length and rise of treads, at least and most [m], and their width, which is also that of the
# ground on which no robot falls into a gap
_LOW, _STEEP, _WIDTH = (0.25, 0.05), (0.4, 0.15), 1.2


def main(config: StonesConfig, resume_hint: str = "resume=True") -> list[WalkResult]:
    """Train a policy and evaluate it over the region of the library; see `ppo_aslip.main`.

    Args:
        config: the settings.
        resume_hint: command that resumes the training, for messages.
    """
    config = with_schedule(config, read_settings(config.out)[0] if config.resume else None)
    return ppo_directions.main(
        config,
        resume_hint,
        make_stack=partial(plans_everywhere, config),
        add_training=partial(add_footsteps, config),
        numbers=[("plan", "on_stones")],
        make_actor=make_planned_actor,
    )


def plans_everywhere(config: StonesConfig, library: GaitLibrary) -> Stack:
    """Stack whose robots follow plans on the floor, too."""
    # exact plans are for CPUs
    planner = BatchPlanner(default_planner().program) if config.backend == "warp" else None
    stack = planned_stack(library, planner=planner)
    return insert_before(stack, "reference", footsteps=RandomFootsteps(0.0, 0.0))


def add_footsteps(config: StonesConfig, stack: Stack) -> Stack:
    """Stack for training with courses, and with displaced footholds on the floor."""
    if config.courses:
        stack = course_stack(stack, *course_pool(config.courses, config.supported))
        cast("CourseCommand", stack["command"]).speeds = _SPEEDS
    footsteps = RandomFootsteps(
        config.footstep_ahead,
        config.footstep_sideways,
        difficulty_key="difficulty" if "difficulty" in stack else None,
    )
    return {**stack, "footsteps": footsteps}


def course_pool(share: float, supported: float) -> tuple[np.ndarray, np.ndarray]:
    """Stones (p, s, 6) of random courses, and none at all for the rest of the episodes.

    The second array are the stones that robots see. A share of the first reach to the next ones,
    unless the course turns.
    """
    rng = np.random.default_rng(_SEED)
    courses = [
        random_stones(rng, _EACH, count=_COUNT, size=size, difficulty=difficulty)
        for size in _SIZES
        for difficulty in _DIFFICULTIES
    ]
    courses += [varied_stones(rng, len(_DIFFICULTIES) * _EACH, size) for size in _SIZES]
    stones = np.concatenate(courses)
    flat = np.full((round(len(stones) * (1 - share) / share), *stones.shape[1:]), np.nan)
    shown = np.concatenate([stones, flat])
    ground, turns = shown.copy(), (np.nan_to_num(shown[..., 3]) != 0).any(1)
    widened = (rng.random(len(shown)) < supported) & ~turns
    ground[widened] = touching(shown[widened])
    return ground, shown


def varied_stones(rng: np.random.Generator, num: int, size: float) -> np.ndarray:
    """Stones (num, s, 6) of courses that differ from each other.

    Each has its own length, width and rise of steps. Some turn, and some are stairs.
    """
    step, apart, rise = rng.uniform(_LEAST, _MOST, (num, 3)).T[..., None]
    longer, higher = rng.uniform(-1.0, 1.0, (2, num, _COUNT))
    heading = rng.uniform(-_TURN, _TURN, (num, _COUNT)).repeat(_STRAIGHT, 1)[:, :_COUNT]
    turns, treads = np.arange(num) < _TURNS * num, np.arange(num) >= (1 - _STAIRS) * num
    step = np.maximum(step + _DIFFERENCES[0] * longer, size + LEAST_GAP)
    rise = rise + _DIFFERENCES[1] * higher
    length, steep = rng.uniform(_LOW, _STEEP, (num, 2)).T[..., None]
    step[treads] = length[treads]
    rise[treads] = (np.sign(rise[:, :1]) * steep)[treads]
    turn = np.diff(heading * turns[:, None], axis=1, prepend=0.0)
    stones = lay_stones(step, apart=apart, rise=rise, turn=turn, size=size)
    stones[treads, 1:-1, 1], stones[treads, 1:-1, 5] = 0.0, _WIDTH
    stones[treads, 1:-1, 4] = length[treads]
    return stones


def touching(stones: np.ndarray) -> np.ndarray:
    """Stones (p, s, 6) of courses straight ahead, wide, and so long that there is no gap."""
    start, end = stones[..., 0] - stones[..., 4] / 2, stones[..., 0] + stones[..., 4] / 2
    middle = (start[:, 1:] + end[:, :-1]) / 2
    start[:, 1:], end[:, :-1] = middle, middle
    wide = stones.copy()
    wide[..., 0], wide[..., 4] = (start + end) / 2, end - start
    wide[..., 5] = np.where(np.isfinite(end), _WIDTH, np.nan)
    return wide


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, resume_hint=resume_command(CONFIG))
