"""Errors of the state estimate on walks at constant and changing speeds."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tensordict import TensorDictBase

from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.estimation import StateEstimator
from aslip.estimation.filter import P, V
from aslip.robot import CASSIE
from aslip.show.palette import LEFT, RIGHT, ROBOT
from aslip.walking import reset_walks, walk
from benchmarks.common import Subject

SPEEDS: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Speeds of the walks at constant speed [m/s]; a walk at changing speed follows."""

# policy step -> commanded speed [m/s]
_CHANGES = {0: 0.0, 60: 1.0, 130: 2.0, 200: 0.3, 270: 1.5, 340: 0.0}
_POSE = ("position", "orientation", "velocity")


@dataclass
class EstimateErrors:
    """Errors of n robots at t policy steps; NaN after a fall."""

    velocity: np.ndarray
    """(t, n, 3) error of the velocity [m/s]."""
    height: np.ndarray
    """(t, n) error of the height [m]."""
    angle: np.ndarray
    """(t, n) angle between estimated and true attitude [rad]."""
    position: np.ndarray
    """(t, n, 3) error of the position [m]."""
    travelled: np.ndarray
    """(t, n) true position along x [m]."""
    nis: np.ndarray
    """(t, n) normalised innovation squared, mean over packets and feet."""
    nis_inside: np.ndarray
    """(t, n) share of packets and feet within the 95 % band."""
    nees_velocity: np.ndarray
    """(t, n) normalised error squared of the velocity."""
    nees_height: np.ndarray
    """(t, n) normalised error squared of the height."""
    seen: dict[str, np.ndarray]
    """Truth and estimate, by name."""


def record_estimates(subject: Subject, steps: int, repeats: int, seed: int) -> EstimateErrors:
    """Compare estimate and truth on walks at each speed and at changing speed.

    Args:
        subject: policy that walks.
        steps: policy steps of a walk.
        repeats: robots on each walk, with different sensor noise.
        seed: seed of the noise.
    """
    num_envs = (len(SPEEDS) + 1) * repeats
    with closing(subject.env(num_envs, seed=seed, drop=["fall", *EPISODE_ENDS])) as env:
        return _compare(_record(subject, env, _commands(steps, repeats)))


def packets(td: TensorDictBase) -> np.ndarray:
    """(n, w, 42) packets of the sensors, with noise."""
    return np.concatenate([array(td, ("sensors", name)) for name in CASSIE.packet_sizes], axis=-1)


def array(td: TensorDictBase, key: Any) -> np.ndarray:
    """Entry of a tensordict as an array; floats in double precision."""
    value = cast("torch.Tensor", td[key])
    return value.double().numpy() if value.is_floating_point() else value.numpy()


def _commands(steps: int, repeats: int) -> np.ndarray:
    """(steps, n) commanded speed of each robot [m/s]; changing speeds come last."""
    changing = [max(i for i in _CHANGES if i <= step) for step in range(steps)]
    command = np.tile([*SPEEDS, 0.0], (steps, 1))
    command[:, -1] = [_CHANGES[i] for i in changing]
    return np.repeat(command, repeats, axis=1).astype(np.float32)


def _record(subject: Subject, env: StackEnv, command: np.ndarray) -> dict[str, np.ndarray]:
    """Record truth and estimate at each policy step (t, n, ...), by name."""
    start = reset_walks(env, command[0])
    estimator = StateEstimator()
    tracking, _ = estimator.start(packets(start))
    frames: list[dict[str, np.ndarray]] = []
    for step in walk(subject.policy, env, start, len(command), command=command):
        td = cast("TensorDictBase", step["next"])
        estimate = estimator.update(tracking, packets(td))
        inside = np.where(estimate.resting[..., None], estimate.innovation, np.nan).sum(-1)
        variance = np.einsum("...ii->...i", tracking.belief.covariance)
        frames.append(
            {
                "inside": inside,
                "velocity_variance": variance[..., V],
                "height_variance": variance[:, 2, P],
                "command": array(td, "command"),
                **{f"truth_{k}": array(td, ("true_odometry", f"pelvis_{k}")) for k in _POSE},
                **{f"estimate_{k}": array(td, ("odometry", f"pelvis_{k}")) for k in _POSE},
                "force": array(td, ("truth", "ground_force"))[..., 2],
                "contact": array(td, ("estimator", "contact")),
            }
        )
    return {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}


def _compare(seen: dict[str, np.ndarray]) -> EstimateErrors:
    """Compute errors from truth and estimate."""
    fallen = np.logical_or.accumulate(seen["truth_position"][..., 2] < CASSIE.fall_height, axis=0)
    unfallen = np.where(fallen, np.nan, 1.0)
    velocity = (seen["estimate_velocity"] - seen["truth_velocity"]) * unfallen[..., None]
    position = (seen["estimate_position"] - seen["truth_position"]) * unfallen[..., None]
    turns = [
        Rotation.from_quat(seen[f"{kind}_orientation"].reshape(-1, 4), scalar_first=True)
        for kind in ("truth", "estimate")
    ]
    low, high = chi2.ppf([0.025, 0.975], 3)
    nis = seen["inside"]
    counted = np.isfinite(nis)
    share = np.where(counted, (nis > low) & (nis < high), np.nan)
    return EstimateErrors(
        velocity=velocity,
        height=position[..., 2],
        angle=(turns[0].inv() * turns[1]).magnitude().reshape(fallen.shape) * unfallen,
        position=position,
        travelled=seen["truth_position"][..., 0] * unfallen,
        nis=_mean(nis, (2, 3)) * unfallen,
        nis_inside=_mean(share, (2, 3)) * unfallen,
        nees_velocity=(velocity**2 / seen["velocity_variance"]).sum(-1),
        nees_height=position[..., 2] ** 2 / seen["height_variance"],
        seen=seen,
    )


def walk_rows(walks: EstimateErrors, repeats: int) -> list[dict[str, Any]]:
    """Rows of the table, one for each walk."""
    rows = []
    for i, name in enumerate([*(f"{speed:.1f}" for speed in SPEEDS), "changes"]):
        robots = slice(i * repeats, (i + 1) * repeats)
        last = np.isfinite(walks.travelled[:, robots]).sum(0) - 1
        columns = np.arange(repeats)
        distance = walks.travelled[:, robots][last, columns] - walks.travelled[0, robots]
        slip = walks.position[:, robots, 0][last, columns] - walks.position[0, robots, 0]
        rows.append(
            {
                "walk": name,
                "velocity": np.sqrt(_mean(walks.velocity[:, robots] ** 2, (0, 1))).tolist(),
                "height": float(np.sqrt(np.nanmean(walks.height[:, robots] ** 2))),
                "angle": float(np.nanmax(walks.angle[:, robots])),
                "distance": float(distance.mean()),
                "drift": float(np.abs(slip).mean()),
                "nis": float(np.nanmean(walks.nis[:, robots])),
                "nis_inside": float(np.nanmean(walks.nis_inside[:, robots])),
                "nees_velocity": float(np.nanmean(walks.nees_velocity[:, robots])),
                "nees_height": float(np.nanmean(walks.nees_height[:, robots])),
                "fallen": int((last < len(walks.travelled) - 1).sum()),
            }
        )
    return rows


WALK_COLUMNS = {
    "walk [m/s]": "{walk}",
    "velocity RMSE x, y, z [m/s]": lambda row: ", ".join(f"{v:.3f}" for v in row["velocity"]),
    "height RMSE [mm]": lambda row: f"{1e3 * row['height']:.1f}",
    "worst attitude error [deg]": lambda row: f"{np.rad2deg(row['angle']):.2f}",
    "drift in x [m]": "{drift:.2f}",
    "drift [% of the distance]": lambda row: (
        f"{100 * row['drift'] / row['distance']:.1f}" if row["distance"] > 1 else "-"
    ),
    "NIS": "{nis:.1f}",
    "in band [%]": lambda row: f"{100 * row['nis_inside']:.0f}",
    "NEES velocity": "{nees_velocity:.1f}",
    "NEES height": "{nees_height:.1f}",
    "falls": "{fallen}",
}


def _mean(values: np.ndarray, axis: tuple[int, ...]) -> np.ndarray:
    """Mean of finite values; NaN where there is none."""
    counted = np.isfinite(values)
    total, number = np.where(counted, values, 0.0).sum(axis), counted.sum(axis)
    return np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)


def picture(walks: EstimateErrors, repeats: int) -> Figure:
    """Draw truth and estimate of the first walk at changing speed."""
    robot = len(SPEEDS) * repeats
    seen = {key: values[:, robot] for key, values in walks.seen.items()}
    seconds = CASSIE.policy_period * np.arange(1, len(seen["force"]) + 1)
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    for i, name in enumerate("xyz"):
        axes[i].plot(seconds, seen["truth_velocity"][:, i], "k", lw=1.6, label="truth")
        axes[i].plot(seconds, seen["estimate_velocity"][:, i], ROBOT, lw=1, label="estimate")
        axes[i].set_ylabel(f"velocity {name} [m/s]")
    axes[0].step(seconds, seen["command"][:, 0], "0.6", lw=1, where="pre", label="command")
    axes[3].plot(seconds, seen["truth_position"][:, 2], "k", lw=1.6)
    axes[3].plot(seconds, seen["estimate_position"][:, 2], ROBOT, lw=1)
    axes[3].set_ylabel("height [m]")
    for i, (side, color) in enumerate((("left", LEFT), ("right", RIGHT))):
        axes[4].plot(seconds, seen["force"][:, i], color, lw=0.8, label=f"{side} foot")
        axes[4].fill_between(
            seconds, -150 - 60 * i, -100 - 60 * i, where=seen["contact"][:, i], color=color, lw=0
        )
    axes[4].set_ylabel("ground force [N]\n(bars: estimated contact)")
    axes[4].set_ylim(top=1.4 * seen["force"].max())  # with room for the legend
    axes[4].set_xlabel("time [s]")
    axes[0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[4].legend(loc="upper right", ncols=2, fontsize=8)
    figure.suptitle("State estimate on a walk at changing speed, noisy sensors")
    return figure
