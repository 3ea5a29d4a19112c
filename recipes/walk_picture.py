"""Draw one stride of the robot beneath the reduced-order model that guides it.

    python recipes/walk_picture.py --policy runs/ppo_aslip --speed 1.0
    python recipes/walk_picture.py --out docs/images/reference.png      # no policy: the reference

Above: body and spring legs of the actuated SLIP as the policy is told to follow them. Below: the
robot at the same instants. Without a display: MUJOCO_GL=egl, or MUJOCO_GL=osmesa in software.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.figure import Figure
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

import aslip
from aslip.cassie import POLICY_PERIOD
from aslip.errors import ConfigurationError
from aslip.ghost import Ghost
from aslip.plots import save_figure
from aslip.render import render_robot, strip

# a foot of the reference that moves slower over ground is in stance [m/s]
_STANCE_SPEED = 0.05


@dataclass(frozen=True)
class Config:
    """What to draw."""

    policy: str | None = None
    """Name of a shipped policy, its file, or the folder of a run; without one, the robot is put
    on the reference motion, without physics."""
    speed: float = 1.0
    """Commanded speed [m/s]."""
    out: Path = Path("docs/images/walking.png")
    """Where the picture goes."""
    frames: int = 6
    """Instants of the stride, at equal steps of phase."""
    settle: float = 3.0
    """Walk for so long before the stride that is drawn [s]."""
    camera: str = "side"
    """Camera of the model: side, follow or front."""
    overlay: bool = False
    """Draw the reduced-order model through the robot as well."""
    width: int = 320
    """Of one frame [pixels]."""
    height: int = 400
    """Of one frame [pixels]."""

    def __post_init__(self) -> None:
        """Check what would fail late."""
        if self.frames < 1:
            raise ConfigurationError(f"frames must be 1 or more, got {self.frames}")
        if not 0 <= self.settle <= 10:
            raise ConfigurationError(f"settle must be 0 to 10 s, got {self.settle}")


@dataclass(frozen=True)
class Stride:
    """Instants of a walk."""

    phase: np.ndarray
    """(n,) stride fraction."""
    qpos: np.ndarray
    """(n, 35) the robot."""
    ghosts: list[Ghost]
    """The reduced-order model at each instant."""


def main(config: Config) -> None:
    """Walk, choose the instants, draw."""
    library = aslip.GaitLibrary.load()
    speed = library.check_speed(config.speed)
    wanted = np.arange(config.frames) / config.frames
    if config.policy is None:
        phase, qpos = kinematic_stride(library, speed, wanted)
    else:
        phase, qpos = walked_stride(library, config.policy, speed, wanted, config.settle)
    stride = Stride(phase, qpos, reference_ghosts(library, speed, phase, qpos))
    save_figure(draw(stride, config), config.out)
    print(config.out)


def kinematic_stride(
    library: aslip.GaitLibrary, speed: float, phase: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The robot on the reference: phases as given (n,) and configurations (n, 35)."""
    column = torch.from_numpy(phase)[:, None]
    qpos, _ = library.initial_state(column, torch.full_like(column, speed))
    # the library's motion is relative to uniform motion
    qpos[:, 0] += column[:, 0] * speed * stride_duration(library, speed)
    return phase, qpos.numpy()


@torch.no_grad()
def walked_stride(
    library: aslip.GaitLibrary, policy: str, speed: float, wanted: np.ndarray, settle: float
) -> tuple[np.ndarray, np.ndarray]:
    """The first whole stride after a while of walking.

    Args:
        library: gives the duration of a stride.
        policy: what `aslip.load_policy` takes.
        speed: commanded speed [m/s].
        wanted: (n,) ascending phases in [0, 1).
        settle: time to walk before [s].

    Returns:
        Phases (n,) of the policy steps nearest to those wanted, and configurations (n, 35).

    Raises:
        ConfigurationError: the robot fell before the stride was over.
    """
    actor = aslip.load_policy(policy)
    env = aslip.make_env(num_envs=1, num_threads=1, library=library)
    duration = stride_duration(library, speed)
    first = int(np.ceil(settle / duration))
    time = (first + wanted) * duration
    steps = np.rint(time / POLICY_PERIOD).astype(int)
    command = torch.full((1, 1), speed)
    td = env.reset(TensorDict(command=command, phase=torch.zeros(1, 1), batch_size=1))
    path = [td["truth", "qpos"][0].numpy()]
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        while len(path) <= steps[-1]:
            after = env.step(actor(td))["next"]
            path.append(after["truth", "qpos"][0].numpy().copy())
            if after["terminated"].item():
                raise ConfigurationError(
                    f"the robot fell after {len(path) * POLICY_PERIOD:.2f} s; the stride to draw"
                    f" ends at {steps[-1] * POLICY_PERIOD:.2f} s: lower --settle"
                )
            td = step_mdp(td.set("next", after))
    return steps * POLICY_PERIOD / duration % 1.0, np.stack(path)[steps]


def stride_duration(library: aslip.GaitLibrary, speed: float) -> float:
    """Duration of a stride [s]."""
    return float(library.stride(torch.tensor([[speed]], dtype=torch.float64)))


def reference_ghosts(
    library: aslip.GaitLibrary, speed: float, phase: np.ndarray, qpos: np.ndarray
) -> list[Ghost]:
    """The reduced-order model at (n,) phases, over the ground under the robot's pelvis."""
    column = torch.from_numpy(phase)[:, None]
    motion = library.lookup(column, torch.full_like(column, speed))
    body = qpos[:, :3].copy()
    body[:, 2] = motion.body_position[:, 2].numpy()
    left, right = (
        body + foot.numpy() for foot in (motion.left_foot_position, motion.right_foot_position)
    )
    stance = [
        velocity.norm(dim=-1).numpy() < _STANCE_SPEED
        for velocity in (motion.left_foot_velocity, motion.right_foot_velocity)
    ]
    return [Ghost(*row) for row in zip(body, left, right, *stance, strict=True)]


def draw(stride: Stride, config: Config) -> Figure:
    """Two film strips: the reduced-order model, and the robot beneath it."""
    look: dict[str, Any] = {"camera": config.camera, "width": config.width, "height": config.height}
    rom = render_robot(stride.qpos, ghosts=stride.ghosts, robot=False, supersampling=2, **look)
    overlay = stride.ghosts if config.overlay else None
    robot = render_robot(stride.qpos, ghosts=overlay, supersampling=2, **look)
    count = len(stride.phase)
    size = (count * config.width / 110, 2 * config.height / 110 + 0.8)
    figure, rows = plt.subplots(2, 1, figsize=size, layout="constrained")
    figure.get_layout_engine().set(hspace=0.0, h_pad=0.02)  # pyright: ignore
    for axes, frames, name in ((rows[0], rom, "reduced-order model"), (rows[1], robot, "robot")):
        axes.imshow(strip(frames), interpolation="antialiased")
        for i in range(1, count):
            axes.axvline(i * config.width - 0.5, color="white", lw=2)
        axes.set_ylabel(name, fontsize=14)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    labels = [f"phase {phase:.2f}" for phase in stride.phase]
    rows[1].set_xticks((np.arange(count) + 0.5) * config.width, labels, fontsize=13)
    rows[1].tick_params(length=0)
    rows[0].set_title(
        f"one stride at {config.speed:.1f} m/s, from left lift-off; left leg blue, right leg red,"
        " pale in swing",
        fontsize=14,
    )
    return figure


if __name__ == "__main__":
    main(tyro.cli(Config))
