"""Picture of gaits from above: path of the body, footholds, paths of the swing feet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from aslip.base.imports import extras
from aslip.rom import Gait
from aslip.show.palette import LEFT, MODEL, RIGHT

with extras():
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_TOE, _HEEL = 0.09, 0.06
"""Length of a drawn foot ahead of its centre and behind it [m]."""
_MARGIN = 0.15
"""Margin around the drawing [m]."""


def path_figure(gaits: Sequence[Gait], strides: int = 3) -> Figure:
    """Figure of body, footholds and swing feet of gaits, seen from above.

    Args:
        gaits: gaits to draw, one panel each.
        strides: number of strides to draw.
    """
    columns = min(3, len(gaits))
    rows = math.ceil(len(gaits) / columns)
    figure = Figure(figsize=(3.4 * columns, 3.5 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, gait in zip(panels, gaits, strict=False):
        _draw(axes, gait, strides)
    for axes in panels[len(gaits) :]:
        axes.set_axis_off()
    handles = [
        Line2D([], [], color=MODEL, lw=2, label="body"),
        Line2D([], [], color=LEFT, lw=3, label="left foot"),
        Line2D([], [], color=RIGHT, lw=3, label="right foot"),
        Line2D([], [], color="0.5", lw=0.8, ls=":", label="swing"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _draw(axes: Axes, gait: Gait, strides: int) -> None:
    sample = gait.sample(np.linspace(0.0, strides, 300 * strides))
    axes.plot(*sample.body.position[:, :2].T, color=MODEL, lw=2)
    footsteps = gait.sample(np.arange(strides + 1.0))
    for leg, color in enumerate((LEFT, RIGHT)):
        axes.plot(*sample.feet.position[:, leg, :2].T, color=color, lw=0.8, ls=":")
        # the left foot is on the ground at lift-off, the right one in mid-stance
        for centre, angle in zip(
            footsteps.feet.position[:, leg, :2], footsteps.foot_heading[:, leg], strict=True
        ):
            toes = np.array([np.cos(angle), np.sin(angle)])
            axes.plot(*np.stack([centre - _HEEL * toes, centre + _TOE * toes]).T, color=color, lw=3)
    forward, sideways, yaw_rate = (*gait.command, 0.0, 0.0)[:3]
    axes.set_title(f"{forward:g}, {sideways:g} m/s, {yaw_rate:g} rad/s", fontsize=9)
    # equal, square panels around all that was drawn
    box = axes.dataLim
    half = max(box.width, box.height) / 2 + _MARGIN
    x, y = (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.grid(alpha=0.3)
