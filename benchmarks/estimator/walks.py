"""What the estimator makes of walks, against the truth."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.estimation import StateEstimator
from aslip.estimation.filter import P, V
from aslip.policy import policy_stack
from aslip.robot import CASSIE
from aslip.walking import markdown
from benchmarks.estimator.arrays import array, packets
from benchmarks.estimator.config import Config

SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Of the walks at constant speed; one through changes of speed comes after them [m/s]."""

# policy step -> commanded speed [m/s]
_CHANGES = {0: 0.0, 60: 1.0, 130: 2.0, 200: 0.3, 270: 1.5, 340: 0.0}
_POSE = ("position", "orientation", "velocity")


@dataclass
class EstimateErrors:
    """Errors of n robots at t policy steps; NaN after a fall."""

    velocity: np.ndarray
    """(t, n, 3) estimate and truth differ by [m/s]."""
    height: np.ndarray
    """(t, n) [m]."""
    angle: np.ndarray
    """(t, n) between the estimated and the true attitude [rad]."""
    position: np.ndarray
    """(t, n, 3) [m]."""
    travelled: np.ndarray
    """(t, n) true position along x [m]."""
    nis: np.ndarray
    """(t, n) mean over packets and feet."""
    nis_inside: np.ndarray
    """(t, n) share of packets and feet within the 95 % band."""
    nees_velocity: np.ndarray
    """(t, n)."""
    nees_height: np.ndarray
    """(t, n)."""
    seen: dict[str, np.ndarray]
    """Truth and estimate themselves."""


def walk(config: Config) -> EstimateErrors:
    """Walk at each speed, and through changes of speed."""
    env = aslip.make_env(
        num_envs=(len(SPEEDS) + 1) * config.repeats,
        seed=config.seed,
        stack=policy_stack(config.policy),
        drop=["fall", *EPISODE_ENDS],
    )
    with closing(env):
        return _compare(_walk(config, env))


def _walk(config: Config, env: StackEnv) -> dict[str, np.ndarray]:
    """Truth and estimate at each policy step (t, n, ...), by name."""
    names, num = [*SPEEDS, None], env.num_envs
    policy = aslip.load_policy(config.policy)
    commands = torch.tensor([_CHANGES[0] if name is None else name for name in names])
    commands = commands.repeat_interleave(config.repeats)[:, None]
    changing = torch.tensor([name is None for name in names]).repeat_interleave(config.repeats)
    initial = {"command": commands, "phase": torch.zeros(num, 1)}
    td = env.reset(TensorDict(initial, batch_size=[num]))
    estimator = StateEstimator()
    tracking, _ = estimator.start(packets(td))
    frames: list[dict[str, np.ndarray]] = []
    for step in range(config.steps):
        if step in _CHANGES:
            td["command"] = torch.where(changing[:, None], _CHANGES[step], td["command"])
        td = cast("TensorDict", step_mdp(env.step(policy(td))))
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
    """One row of numbers a walk."""
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


def walk_table(rows: list[dict[str, Any]]) -> str:
    """A row a walk."""
    header = [
        "walk m/s", "velocity RMSE x, y, z m/s", "height RMSE mm", "attitude, worst deg",
        "drift of x m", "of the way", "NIS", "in band", "NEES velocity", "NEES height", "falls",
    ]  # fmt: skip
    cells = []
    for row in rows:
        share = f"{100 * row['drift'] / row['distance']:.1f} %" if row["distance"] > 1 else "-"
        cells.append(
            [
                row["walk"],
                ", ".join(f"{value:.3f}" for value in row["velocity"]),
                f"{1e3 * row['height']:.1f}",
                f"{np.rad2deg(row['angle']):.2f}",
                f"{row['drift']:.2f}",
                share,
                f"{row['nis']:.1f}",
                f"{100 * row['nis_inside']:.0f} %",
                f"{row['nees_velocity']:.1f}",
                f"{row['nees_height']:.1f}",
                str(row["fallen"]),
            ]
        )
    return markdown(header, cells)


def _mean(values: np.ndarray, axis: tuple[int, ...]) -> np.ndarray:
    """Mean of what is a number; NaN where nothing is."""
    counted = np.isfinite(values)
    total, number = np.where(counted, values, 0.0).sum(axis), counted.sum(axis)
    return np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)
