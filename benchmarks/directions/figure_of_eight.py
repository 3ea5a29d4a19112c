"""Figure of eight, with feedback of the estimated pose.

    python -m benchmarks.directions.figure_of_eight --policy runs/ppo_directions
    python -m benchmarks.directions.figure_of_eight --policy runs/ppo_directions --video eight.mp4

As on a robot, a control law (`aslip.control.PathFollower`) computes commands from the pose of the
state estimator's odometry. Errors are distances of the estimated and of the true pose from their
nearest points of the path; dead reckoning drifts, so they differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import Directions, check_numbers


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    radius: float = 3.0
    """Radius of the circles [m]."""
    speed: float = 0.8
    """Speed along the path [m/s]."""
    duration: float = 300.0
    """Duration of the walk [s]."""
    video: Path | None = None
    """Film of the first policy's walk, such as eight.mp4; drawing takes minutes."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_numbers(self, "radius", "speed", "duration")
        if self.video is not None and self.video.suffix != ".mp4":
            raise ConfigurationError(
                f"the name of a film must end in .mp4, got {str(self.video)!r}"
            )


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import contextlib
from typing import Any, cast

import mujoco
import numpy as np
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase
from tqdm import tqdm

from aslip.control import Eight, PathFollower
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw
from aslip.show.film import Frame, Look, make_film
from aslip.show.palette import MODEL, ROBOT
from aslip.walking import next_start, policy_steps, reset_walks, take_step
from aslip.walking.record import commands_kept
from benchmarks.common import MakeEnv, Policies, Policy, Report, Subject, benchmark, table

_POINTS = 500  # number of points of the drawn path
_STEPS_PER_FRAME = 4  # policy steps between frames of the film
_SPEED_UP = 2  # speed of the film over that of the walk
_DISTANCE, _ELEVATION = 3.3, -40.0  # of the film's camera [radii, deg]


COLUMNS = {
    "policy": "{policy}",
    "walked [s]": lambda row: f"{row['time']:.1f}" + (" fell" if row["fell"] else ""),
    "mean error, estimate [cm]": lambda row: f"{100 * row['estimate']:.1f}",
    "largest [cm]": lambda row: f"{100 * row['estimate_most']:.1f}",
    "mean error, truth [cm]": lambda row: f"{100 * row['truth']:.1f}",
}


def main(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> list[dict[str, Any]]:
    """Measure, print and draw, then make the film; return a row for each policy."""
    rows, frames = measure(config, policy, make_env)
    if config.video is not None:
        rate = _SPEED_UP / (_STEPS_PER_FRAME * CASSIE.policy_period)
        make_film(config.video, frames, rate, look(config.radius))
    return rows


@benchmark
def measure(config: Config, policies: Policies) -> Report[tuple[list[dict[str, Any]], list[Frame]]]:
    """Walk; the result is a row for each policy, and the frames of the first one's film."""
    subjects = policies.load()
    follower = PathFollower(Eight(config.radius), config.speed)
    found = [walk_path(config, one, subjects[0].library, follower) for one in subjects]
    rows, places, frames = zip(*found, strict=True)
    figure = picture(config.radius, places[0])
    return Report(([*rows], frames[0]), table(COLUMNS, rows), figure, {"rows": rows})


def walk_path(
    config: Config, subject: Subject, library: GaitLibrary, follower: PathFollower
) -> tuple[dict[str, Any], np.ndarray, list[Frame]]:
    """Walk one robot along the path.

    Returns:
        Numbers of the walk; positions (m, 2, 2), estimated and true, before each policy step [m];
        and frames of the film, none without one.
    """
    start, along, true_along = (config.speed, 0.0, 0.0), 0.0, 0.0
    places, distances, frames, fell = [], [], [], False
    with contextlib.closing(subject.walking_env(config, 1)) as env, commands_kept(env):
        td: TensorDictBase = reset_walks(env, library.nearest(torch.tensor([start])).numpy())
        for _ in tqdm(range(policy_steps(config.duration)), unit="step", leave=False):
            heading = float(cast("torch.Tensor", td["heading"]))
            estimated, true = (world_pose(td, group) for group in ("odometry", "true_odometry"))
            command, along = follower.command(estimated, heading, along)
            true_along += follower.errors(true, true_along)[0]
            td["command"] = library.nearest(torch.tensor([command]))
            if config.video is not None and len(places) % _STEPS_PER_FRAME == 0:
                frames.append(Frame.of(td, len(places) * CASSIE.policy_period))
            td = take_step(subject.policy, env, td)
            places.append([estimated[:2], true[:2]])
            nearest = (estimated, along), (true, true_along)
            distances.append([math.hypot(*follower.errors(*one)[:2]) for one in nearest])
            if fell := bool(td["next", "terminated"]):
                break
            td = next_start(td)
    errors = np.array(distances)
    row = {
        "policy": subject.name,
        "time": len(errors) * CASSIE.policy_period,
        "fell": fell,
        "estimate": float(errors[:, 0].mean()),
        "estimate_most": float(errors[:, 0].max()),
        "truth": float(errors[:, 1].mean()),
    }
    return row, np.array(places), frames


def world_pose(td: TensorDictBase, group: str) -> tuple[float, float, float]:
    """Position [m] and yaw [rad] of a pelvis in the world, from its odometry along the path.

    Args:
        td: tensordict of one robot.
        group: "odometry", the estimate, or "true_odometry".
    """
    entries = cast("TensorDictBase", td[group])
    heading = float(cast("torch.Tensor", td["heading"]))
    x, y, _ = entries["pelvis_position"][0].tolist()
    origin = entries["origin"][0].tolist()
    cosine, sine = math.cos(heading), math.sin(heading)
    orientation = cast("torch.Tensor", entries["pelvis_orientation"])[0]
    turned = float(yaw(orientation.double().numpy()))
    place = origin[0] + cosine * x - sine * y, origin[1] + sine * x + cosine * y
    return *place, heading + turned


def look(radius: float) -> Look:
    """Film of the whole path from behind the start, with the path on the floor."""
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = _DISTANCE * radius, 0.0, _ELEVATION
    return Look(camera, 1280, 720, path=path_points(radius))


def path_points(radius: float) -> np.ndarray:
    """Points (n, 2) of the figure of eight [m]."""
    along = np.linspace(0, 4 * math.pi * radius, _POINTS)
    return np.array([Eight(radius).at(each)[0][:2] for each in along])


def picture(radius: float, places: np.ndarray) -> Figure:
    """Draw the path, and the estimated and true positions of the first policy, from above."""
    figure = Figure(figsize=(5, 7.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(*places[:, 0].T, color=MODEL, lw=1, label="estimate")
    axes.plot(*places[:, 1].T, color=ROBOT, lw=1, label="truth")
    axes.plot(*path_points(radius).T, "k--", lw=1, label="path")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
