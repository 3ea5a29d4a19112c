"""Ground force of a robot without any policy, against the reduced-order model's.

    python -m benchmarks.paper.open_loop_force

With action zero, motor targets are the stack's reference alone. The robot starts on the reference
at several phases, and its first 0.45 s are compared with the model's. A correlation near one means
that the stack feeds the model's forces forward, so that a policy's force is partly an input.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = (0.0, 1.0)
    """Commanded speeds [m/s]."""
    stacks: tuple[str, ...] = ("straight", "paper")
    """Stacks, by name."""
    phases: int = 4
    """Number of phases to start at, evenly spaced."""
    steps: int = 15
    """Policy steps from each start."""
    out: Path = Path("runs/benchmarks")
    """Folder for table and results."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_numbers(self, phases=1, steps=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from contextlib import closing
from typing import Any

import numpy as np
import torch
from scipy.ndimage import uniform_filter1d
from tensordict import TensorDict

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.walking.metrics.force import SMOOTHING
from benchmarks.common import nearest_motion, table, write_results
from benchmarks.paper.ground_force import VERTICAL

COLUMNS = {
    "stack": "{stack}",
    "command [m/s]": "{speed:g}",
    "correlation with the model's force": "{correlation:.2f}",
}


def main(config: Config) -> list[dict[str, Any]]:
    """Measure, print and write; returns a row for each stack and speed."""
    library = GaitLibrary.load()
    rows = [
        {"stack": stack, "speed": speed, "correlation": correlation(config, library, stack, speed)}
        for stack in config.stacks
        for speed in config.speeds
    ]
    write_results(config.out, "open_loop_force", {"rows": rows}, table(COLUMNS, rows))
    return rows


def correlation(config: Config, library: GaitLibrary, stack: str, speed: float) -> float:
    """Correlation of vertical foot forces, robot and model, over all starts and both feet."""
    gait = nearest_motion(library, speed)
    robot, model = [], []
    env = aslip.make_env(stack=stack, drop=EPISODE_ENDS, num_threads=1, seed=0)
    with closing(env):
        env.base_env.watch(0)
        for phase in np.arange(config.phases) / config.phases:
            robot.append(open_loop_forces(env, speed, phase, config.steps))
            time = (1 + np.arange(len(robot[-1]))) * CASSIE.physics_timestep
            model.append(gait.sample(phase + time / gait.stride).ground_force[..., 2])
    length = round(SMOOTHING / CASSIE.physics_timestep)
    flat = [
        np.concatenate([uniform_filter1d(one, length, axis=0) for one in kind]).ravel()
        for kind in (robot, model)
    ]
    return float(np.corrcoef(flat)[0, 1])


def open_loop_forces(env: StackEnv, speed: float, phase: float, steps: int) -> np.ndarray:
    """(m, 2) vertical forces at 2 kHz of both feet with action zero [N].

    Args:
        env: environment of one robot, which is watched.
        speed: commanded speed [m/s].
        phase: stride fraction to start at.
        steps: policy steps.
    """
    start = {"command": torch.full((1, 1), speed), "phase": torch.full((1, 1), phase)}
    td, parts = env.reset(TensorDict(start, [1])), []
    for _ in range(steps):
        td = env.step_mdp(env.step(td.set("action", env.action_spec.zero())))
        parts.append(env.base_env.watched[:, VERTICAL].copy())
    return np.concatenate(parts)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
