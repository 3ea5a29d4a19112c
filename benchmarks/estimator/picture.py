"""Truth and estimate of a walk."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from aslip.robot import CASSIE
from benchmarks.estimator.walks import SPEEDS, EstimateErrors


def picture(walks: EstimateErrors, repeats: int) -> Figure:
    """Truth and estimate of the first walk through changes of speed."""
    robot = len(SPEEDS) * repeats
    seen = {key: values[:, robot] for key, values in walks.seen.items()}
    seconds = CASSIE.policy_period * np.arange(1, len(seen["force"]) + 1)
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    for i, name in enumerate("xyz"):
        axes[i].plot(seconds, seen["truth_velocity"][:, i], "k", lw=1.6, label="truth")
        axes[i].plot(seconds, seen["estimate_velocity"][:, i], "tab:red", lw=1, label="estimate")
        axes[i].set_ylabel(f"velocity {name} [m/s]")
    axes[0].step(seconds, seen["command"][:, 0], "0.6", lw=1, where="pre", label="command")
    axes[3].plot(seconds, seen["truth_position"][:, 2], "k", lw=1.6)
    axes[3].plot(seconds, seen["estimate_position"][:, 2], "tab:red", lw=1)
    axes[3].set_ylabel("height [m]")
    for i, (side, color) in enumerate((("left", "tab:blue"), ("right", "tab:green"))):
        axes[4].plot(seconds, seen["force"][:, i], color, lw=0.8, label=f"{side} foot")
        axes[4].fill_between(
            seconds, -150 - 60 * i, -100 - 60 * i, where=seen["contact"][:, i], color=color, lw=0
        )
    axes[4].set_ylabel("ground force [N]\n(bars: estimated contact)")
    axes[4].set_xlabel("time [s]")
    axes[0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[4].legend(loc="upper right", ncols=2, fontsize=8)
    figure.suptitle("State estimate of a walk through changes of speed, noisy sensors")
    return figure
