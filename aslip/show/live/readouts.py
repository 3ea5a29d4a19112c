"""Numbers on the page: lines of text, a plot of speed, bars of the reward terms."""

from __future__ import annotations

import html
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
import viser
import viser.uplot as uplot
from tensordict import TensorDictBase

from aslip.robot import CASSIE
from aslip.show.palette import COMMAND, MODEL, ROBOT
from aslip.transforms.rewards import PAPER_WEIGHTS

ROBOT_LABEL = CASSIE.name.capitalize()
"""Name of the robot on the page."""

PLOT_SPAN = 8.0
"""Time span of the plot [s]."""

# [pixels], with room for half a number above and to the right
_PLOT_HEIGHT, _PLOT_PADDING = 320, (12, 16, 0, 0)
# the vertical axis extends beyond the curves by a margin, to a multiple of a step [m/s]
_MARGIN, _SPEED_STEP = 0.02, 0.2
_CURVES: tuple[uplot.Series, ...] = (
    {"label": "spring-mass model", "stroke": MODEL, "width": 1.5},
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
_TERM_COLOR, _TOTAL_COLOR, _ALARM_COLOR = "#9aa5b8", "#333d52", "#c92a2a"


@dataclass(frozen=True)
class Turning:
    """Numbers of a walk in all directions."""

    sideways: float
    """Speed of the pelvis to the left [m/s]."""
    yaw_rate: float
    """Yaw rate of the pelvis [rad/s]."""
    command: tuple[float, ...]
    """Commanded forward, sideways speed [m/s] and yaw rate [rad/s]."""
    off_path: float
    """Distance of the pelvis from the place that it should have [m]."""
    mode: str = ""
    """Mode of a robot that can stand, "walk", "stop", "stand" or "start"; empty for others."""


@dataclass(frozen=True)
class Status:
    """Numbers of the lines of text."""

    time: float
    """Time since the last reset [s]."""
    speed: float
    """Forward speed of the pelvis [m/s]."""
    height: float
    """Height of the pelvis [m]."""
    ahead: float
    """Distance ahead since the last reset [m]."""
    left: float
    """Distance to the left since the last reset [m]."""
    falls: int
    """Falls since the page was opened."""
    factor: float | None
    """Real-time factor; None while paused."""
    message: str
    """Message to visitors; may be empty."""
    turning: Turning | None = None
    """Numbers of a walk in all directions; None in straight walks."""


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

    def show(self, status: Status) -> None:
        """Update lines, plot and bars; meant for a few calls per second."""
        self._lines.content = _lines(status, self._mean_speed())
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

    def _mean_speed(self) -> float:
        """Mean speed of the robot over the span of the plot [m/s]; 0 before the first step."""
        return float(np.mean([speed for _, speed, _ in self._history])) if self._history else 0.0


def _lines(status: Status, mean_speed: float) -> str:
    factor = "paused" if status.factor is None else f"real-time factor {status.factor:.2f}"
    walk = (
        ("forward speed", f"{status.speed:z.2f} m/s", f"mean {mean_speed:z.2f} m/s"),
        ("moved", f"{status.ahead:z.2f} m ahead", f"{status.left:z.2f} m left"),
    )
    if (turning := status.turning) is not None:
        forward, sideways, yaw_rate = (f"command {value:z.2f}" for value in turning.command)
        walk = (
            ("forward speed", f"{status.speed:z.2f} m/s", forward),
            ("sideways speed", f"{turning.sideways:z.2f} m/s", sideways),
            ("yaw rate", f"{turning.yaw_rate:z.2f} rad/s", yaw_rate),
            ("off the path", f"{turning.off_path:.2f} m", turning.mode),
        )
    entries = (
        ("time", f"{status.time:.2f} s", factor),
        *walk,
        ("pelvis height", f"{status.height:.3f} m", f"{status.falls} falls"),
    )
    rows = "".join(
        f"<tr><td>{name}</td><td style='font-weight:600'>{value}</td>"
        f"<td style='text-align:right'>{more}</td></tr>"
        for name, value, more in entries
    )
    return (
        "<div style='padding:0.4em 0.8em;font-size:0.85em;font-variant-numeric:tabular-nums'>"
        f"<table style='width:100%'>{rows}</table>"
        f"<div style='min-height:1.5em;font-weight:600;color:{_ALARM_COLOR}'>"
        f"{html.escape(status.message)}</div></div>"
    )


def _bars(reward: Mapping[str, float]) -> str:
    """Table of values from 0 to 1, each with a bar."""
    rows = "".join(
        f"<tr><td style='width:8em'>{html.escape(name)}</td>"
        "<td><div style='height:0.8em;border-radius:2px;background:#e5e7eb'>"
        f"<div style='height:100%;border-radius:2px;width:{100 * min(max(value, 0.0), 1.0):.1f}%;"
        f"background:{_TOTAL_COLOR if name == 'reward' else _TERM_COLOR}'></div></div></td>"
        f"<td style='width:3em;text-align:right'>{value:.2f}</td></tr>"
        for name, value in reward.items()
    )
    return (
        "<div style='padding:0.4em 0.8em;font-size:0.85em;font-variant-numeric:tabular-nums'>"
        f"<table style='width:100%'>{rows}</table></div>"
    )
