"""Numbers on the page: lines of text, a plot of speed, bars of the reward terms."""

from __future__ import annotations

import html
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import torch
import viser
import viser.uplot as uplot
from tensordict import TensorDictBase

from aslip.robot import CASSIE
from aslip.show.palette import COMMAND, ROBOT
from aslip.transforms.rewards import PAPER_WEIGHTS

ROBOT_LABEL = CASSIE.name.capitalize()
"""Name of the robot on the page."""

PLOT_SPAN = 8.0
"""Time span of the plot [s]."""

# [pixels], with room for half a number above and to the right
_PLOT_HEIGHT, _PLOT_PADDING = 320, (12, 16, 0, 0)
# the vertical axis extends beyond the curves by a margin, to a multiple of a step [m/s]
_MARGIN, _SPEED_STEP = 0.02, 0.2
# the model's colour in plots and bars, lighter, to be seen on black, too
_MODEL = "#6b7a99"
_CURVES: tuple[uplot.Series, ...] = (
    {"label": "spring-mass model", "stroke": _MODEL, "width": 1.5},
    {"label": ROBOT_LABEL, "stroke": ROBOT, "width": 2.0},
    {"label": "command", "stroke": COMMAND, "width": 1.5, "dash": (6.0, 4.0)},
)
_LEGEND = "".join(
    f"<span style='margin-right:1em;white-space:nowrap'><span style='display:inline-block;"
    f"width:1.6em;margin-right:0.4em;vertical-align:middle;"
    f"border-top:2px {'dashed' if 'dash' in curve else 'solid'} {curve.get('stroke')}'></span>"
    f"{curve.get('label')}</span>"
    for curve in _CURVES
)
_LEGEND = f"<div style='padding:0 0.8em 0.4em;font-size:0.8em;text-align:center'>{_LEGEND}</div>"
# redraws of a plot for a new visitor: for 2 s, an even number
_REDRAWS = 12
# the paper's terms in its order; others follow
_ORDER = {name: i for i, name in enumerate(PAPER_WEIGHTS)}
_TERM_COLOR, _ALARM_COLOR = "#9aa5b8", "#e03131"


class Readouts:
    """Lines of text, bars and a plot.

    Args:
        gui: interface of the server, within the panel to fill.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._time = CASSIE.policy_period * np.arange(-round(PLOT_SPAN / CASSIE.policy_period), 1)
        self._history: deque[tuple[float, float, float]] = deque(maxlen=len(self._time))
        self._reward: dict[str, float] = {}
        self._redraws = 0
        self._lines = gui.add_html("")
        self._plot = gui.add_uplot(
            self._curves(),
            ({"label": "time"}, *_CURVES),
            scales=self._scales(),
            axes=({"label": "time [s]"}, {"label": "forward speed [m/s]"}),
            legend={"show": False},
            height=_PLOT_HEIGHT,
            padding=_PLOT_PADDING,
        )
        gui.add_html(_LEGEND)
        self._bars = gui.add_html("")

    def add(self, td: TensorDictBase) -> None:
        """Add a policy step, as `Walker.step` returns it."""
        after = cast("TensorDictBase", td["next"])
        speed = after["true_odometry", "pelvis_velocity"][0, 0]
        reference = after["reference", "body_velocity"][0, 0]
        command = cast("torch.Tensor", td["command"])
        self._history.append((float(reference), float(speed), float(command[0, 0])))
        terms = cast("TensorDictBase", after["reward_terms"])
        names = sorted(terms.keys(), key=lambda name: _ORDER.get(name, len(_ORDER)))
        self._reward = {name: float(terms[name]) for name in names}
        self._reward["reward"] = float(after["reward"])

    def redraw(self) -> None:
        """Redraw the plot several times, until the page of a new visitor is laid out.

        uPlot leaves out the time axis of a plot that gets its data before.
        """
        self._redraws = _REDRAWS

    @property
    def redrawing(self) -> bool:
        """Whether redraws of `redraw` are left."""
        return self._redraws > 0

    def show(self, rows: Sequence[Sequence[str]], message: str) -> None:
        """Update lines, plot and bars; meant for a few calls per second.

        Args:
            rows: name, value and remark of each line.
            message: message to visitors; may be empty.
        """
        alarm = f"<div style='min-height:1.5em;font-weight:600;color:{_ALARM_COLOR}'>"
        self._lines.content = f"{text_table(rows)}{alarm}{html.escape(message)}</div>"
        self._redraws = max(self._redraws - 1, 0)
        if (scales := self._scales()) != self._plot.scales:
            self._plot.scales = scales
        self._plot.data = self._curves()
        self._bars.content = _bars(self._reward)

    def _curves(self) -> tuple[np.ndarray, ...]:
        """Time before the present [s] and speeds [m/s], each (n,), NaN before the start.

        The length is constant, because uPlot draws no time axis for a range that data do not fill.
        """
        columns = np.full((len(self._time), len(_CURVES)), np.nan)
        if self._history:
            columns[-len(self._history) :] = self._history
        return (self._time, *columns.T)

    def _scales(self) -> dict[str, uplot.Scale]:
        """Ranges of the axes around the curves, rounded so that they rarely change.

        uPlot itself finds no range for data with NaN.
        """
        speeds = np.array(self._history or [(0.0, 0.0, 0.0)])
        low = _SPEED_STEP * math.floor((speeds.min() - _MARGIN) / _SPEED_STEP)
        high = _SPEED_STEP * math.ceil((speeds.max() + _MARGIN) / _SPEED_STEP)
        return {
            "x": {"time": False, "range": (float(self._time[0]), 0.0)},
            # an invisible change makes browsers redraw the plot
            "y": {
                "range": (round(float(low), 6), round(float(high), 6) + 1e-6 * (self._redraws % 2))
            },
        }


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Table of rows of text; the second column is bold, a third one right-aligned."""
    styles = ("", "font-weight:600", "text-align:right")
    cells = (
        "".join(
            f"<td style='{style}'>{html.escape(cell)}</td>"
            for cell, style in zip(row, styles, strict=False)
        )
        for row in rows
    )
    return _table("".join(f"<tr>{row}</tr>" for row in cells))


def _bars(reward: Mapping[str, float]) -> str:
    """Table of values from 0 to 1, each with a bar."""
    rows = "".join(
        f"<tr><td style='width:8em'>{html.escape(name)}</td>"
        "<td><div style='height:0.8em;border-radius:2px;background:#8883'>"
        f"<div style='height:100%;border-radius:2px;width:{100 * min(max(value, 0.0), 1.0):.1f}%;"
        f"background:{_MODEL if name == 'reward' else _TERM_COLOR}'></div></div></td>"
        f"<td style='width:3em;text-align:right'>{value:.2f}</td></tr>"
        for name, value in reward.items()
    )
    return _table(rows)


def _table(rows: str) -> str:
    return (
        "<div style='padding:0.4em 0.8em;font-size:0.85em;font-variant-numeric:tabular-nums'>"
        f"<table style='width:100%'>{rows}</table></div>"
    )
