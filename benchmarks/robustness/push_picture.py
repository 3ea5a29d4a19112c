"""Picture of the robustness to pushes: impulses around the robot, survival over parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from aslip.show.palette import ROBOT


def picture(
    numbers: dict[str, Any], sides: Mapping[float, str], sweeps: Mapping[str, Any]
) -> Figure | None:
    """Draw impulses around the robot and over the stride, and survival over each parameter.

    Args:
        numbers: numbers of the report.
        sides: names of directions [deg].
        sweeps: name of a parameter -> its `Sweep`.

    Returns:
        The picture; None without pushes and sweeps.
    """
    swept = [name for name in sweeps if any(r["parameter"] == name for r in numbers["sweeps"])]
    heights = [4.6] * bool(numbers["pushes"]) + [2.6] * bool(swept)
    if not heights:
        return None
    figure = Figure(figsize=(12, sum(heights)), layout="constrained")
    parts = list(figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0])
    if numbers["pushes"]:
        part = parts.pop(0)
        impulse = np.array([[cell["mean"] for cell in row["phases"]] for row in numbers["pushes"]])
        polar = cast("PolarAxes", part.add_subplot(1, 2, 1, projection="polar"))
        _draw_polar(polar, impulse, sides)
        _draw_map(part.add_subplot(1, 2, 2), impulse, sides)
        part.suptitle(
            f"largest survivable push at {numbers['speed']:g} m/s: impulse [N s] within"
            f" {numbers['push_duration']:.2g} s"
        )
    if swept:
        panels = parts[0].subplots(1, len(swept), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, swept, strict=True):
            rows = [row for row in numbers["sweeps"] if row["parameter"] == name]
            _draw_sweep(axes, sweeps[name], rows)
    return figure


def _draw_polar(axes: PolarAxes, impulse: np.ndarray, sides: Mapping[float, str]) -> None:
    """Draw impulses (directions, phases) over direction, forward up, with a line for each phase.

    The shaded area is survived at every phase. The map beside it tells the phases apart.
    """
    directions = len(impulse)
    angle = 2 * np.pi * np.arange(directions + 1) / directions
    closed = np.concatenate([impulse, impulse[:1]])
    axes.fill(angle, closed.min(axis=1), color="0.85", label="survived at\nevery phase")
    each, *_ = axes.plot(angle, closed, color="0.6", lw=0.8)
    each.set_label("one phase")
    axes.plot(angle, closed.mean(axis=1), ROBOT, lw=2.5, label="mean over\nphases")
    axes.set_theta_zero_location("N")
    axes.set_thetagrids(list(sides), list(sides.values()))
    axes.set_ylim(0, None)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_rlabel_position(157.5)
    axes.grid(alpha=0.4)
    axes.set_axisbelow(False)
    for label in axes.get_yticklabels():
        label.set_bbox({"fc": "white", "ec": "none", "pad": 1})
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.12, 0.5))


def _draw_map(axes: Axes, impulse: np.ndarray, sides: Mapping[float, str]) -> None:
    """Draw impulses (directions, phases) as a labelled heat map."""
    directions, phases = impulse.shape
    image = axes.imshow(impulse, cmap="viridis", aspect="auto", norm=Normalize(0, impulse.max()))
    for (i, j), value in np.ndenumerate(impulse):
        color = "white" if value < 0.6 * impulse.max() else "black"
        axes.text(j, i, f"{value:.1f}", ha="center", va="center", color=color, fontsize=9)
    axes.set_xticks(range(phases), [f"{j / phases:.3g}" for j in range(phases)])
    degrees = [360 * i / directions for i in range(directions)]
    axes.set_yticks(range(directions), [sides.get(d, f"{d:.0f}°") for d in degrees])
    axes.set(xlabel="phase at which the push begins (0: left lift-off)", ylabel="push direction")
    axes.figure.colorbar(image, ax=axes, label="impulse [N s]")


def _draw_sweep(axes: Any, sweep: Any, rows: list[dict[str, Any]]) -> None:
    """Draw survival over a parameter, with intervals."""
    value = [row["value"] for row in rows]
    mean, low, high = (100 * np.array([row[k] for row in rows]) for k in ("mean", "low", "high"))
    axes.axvline(sweep.nominal, color="0.6", ls="--", lw=1)
    axes.errorbar(value, mean, [mean - low, high - mean], fmt="o-", color=ROBOT, ms=4, capsize=3)
    axes.set(xlabel=sweep.label, ylim=(-4, 104))
    axes.grid(alpha=0.3)
    axes.label_outer()
    if axes.get_subplotspec().colspan.start == 0:
        axes.set_ylabel("walks survived [%]")
