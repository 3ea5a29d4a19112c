"""Film strip of a stride: the reduced-order model above the robot at the same phases.

    python -m benchmarks.paper.film_strip --speed 1.0                # `straight`, as in the paper
    python -m benchmarks.paper.film_strip --policy runs/ppo_aslip

The upper strip shows body and spring legs of the actuated SLIP model, the lower strip the robot at
the same instants.
"""

from __future__ import annotations

import itertools
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the picture."""

    policy: str = "straight"
    """Name of a shipped policy, its file, or the folder of a run."""
    speed: float = 1.0
    """Commanded speed [m/s]."""
    out: Path = Path("runs/film_strip.png")
    """File for the picture."""
    frames: int = 6
    """Number of instants, equally spaced in phase."""
    settle: float = 3.0
    """Duration of the walk before the drawn stride [s]."""
    camera: str = "side"
    """Name of the camera: side, follow or front."""
    width: int = 320
    """Width of one frame [pixels]."""
    height: int = 400
    """Height of one frame [pixels]."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_numbers(self, frames=1)
        if not 0 <= self.settle <= 10:
            raise ConfigurationError(f"settle must be 0 to 10 s, got {self.settle}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.library import numbers
from aslip.robot import CASSIE
from aslip.show.ghost import Ghost
from aslip.show.plots import save_figure
from aslip.show.render import add_ghost, render_frames
from aslip.walking import Walker
from benchmarks.common import MakeEnv, Policy, Subject
from benchmarks.flags import Common


@dataclass(frozen=True)
class Stride:
    """Instants of one stride, n of them."""

    phase: np.ndarray
    """(n,) stride fraction."""
    qpos: np.ndarray
    """(n, 35) configuration of the robot."""
    ghosts: list[Ghost]
    """The reduced-order model at each instant."""


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> None:
    """Walk, and draw the film strip.

    Args:
        config: the settings.
        policy: policy to draw; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    wanted = np.arange(config.frames) / config.frames
    subject = Subject.load(policy or config.policy, make_env)
    (speed,) = subject.library.check_command(config.speed)
    with closing(subject.walking_env(Common(), 1, num_threads=1)) as env:
        walker = Walker(subject.policy, env, library=subject.library, speed=speed)
        stride = simulated_stride(walker, wanted, config.settle)
    save_figure(draw(stride, config), config.out)
    print(config.out)


def simulated_stride(walker: Walker, wanted: np.ndarray, settle: float) -> Stride:
    """First whole stride after `settle`, at the policy steps nearest to the phases.

    Args:
        walker: walker after its reset.
        wanted: (n,) ascending phases in [0, 1).
        settle: duration to walk before [s].

    Raises:
        ConfigurationError: the robot fell before the end of the stride.
    """
    (speed,) = numbers(walker.command)
    duration = walker.library.stride(torch.tensor([[speed]], dtype=torch.float64)).item()
    first = np.ceil(settle / duration)
    steps = np.rint((first + wanted) * duration / CASSIE.policy_period).astype(int)
    phases, path, ghosts = [], [], []
    while walker.steps <= steps[-1]:
        if walker.steps in steps:
            td = walker.td
            phases.append(float(td["phase"]))
            path.append(td["truth", "qpos"][0].numpy().copy())
            ghosts.append(Ghost.of(td))
        walker.step()
        if walker.fallen:
            raise ConfigurationError(
                f"the robot fell after {walker.time:.2f} s; the stride to draw ends at"
                f" {steps[-1] * CASSIE.policy_period:.2f} s: lower --settle"
            )
    return Stride(np.array(phases), np.stack(path), ghosts)


def draw(stride: Stride, config: Config) -> Figure:
    """Draw two film strips: the reduced-order model, and the robot below it."""
    look: dict[str, Any] = {"camera": config.camera, "width": config.width, "height": config.height}
    count = len(stride.phase)
    rom = render_frames(
        stride.qpos,
        add=lambda scene, i: add_ghost(scene, stride.ghosts[i]),
        robot=False,
        supersampling=2,
        **look,
    )
    robot = render_frames(stride.qpos, supersampling=2, **look)
    # software rendering takes seconds per picture
    drawn = tqdm(itertools.chain(rom, robot), total=2 * count, unit="picture", desc="drawing")
    pictures = np.stack(list(drawn))
    size = (count * config.width / 110, 2 * config.height / 110 + 0.8)
    figure, rows = plt.subplots(2, 1, figsize=size, layout="constrained")
    figure.get_layout_engine().set(hspace=0.0, h_pad=0.02)  # pyright: ignore
    for axes, frames, name in (
        (rows[0], pictures[:count], "reduced-order model"),
        (rows[1], pictures[count:], "robot"),
    ):
        axes.imshow(np.hstack(list(frames)), interpolation="antialiased")
        for i in range(1, count):
            axes.axvline(i * config.width - 0.5, color="white", lw=2)
        axes.set_ylabel(name, fontsize=14)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    labels = [f"phase {phase:.2f}" for phase in stride.phase]
    rows[1].set_xticks((np.arange(count) + 0.5) * config.width, labels, fontsize=13)
    rows[1].tick_params(length=0)
    rows[0].set_title(
        f"one stride at {round(config.speed, 3)} m/s, from left lift-off;"
        " left leg blue, right leg red, pale in swing",
        fontsize=14,
    )
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
