"""What the page tells in numbers: a few lines, a plot of speed, bars of the reward's terms."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
import viser
import viser.uplot as uplot
from tensordict import TensorDictBase

from aslip.cassie import POLICY_PERIOD
from aslip.palette import COMMAND, MODEL, ROBOT
from aslip.rewards import PAPER_WEIGHTS

PLOT_SPAN = 8.0
"""What the plot reaches back [s]."""

# [pixels]; above and to the right there must be room for half a number
_PLOT_HEIGHT, _PLOT_PADDING = 320, (12, 16, 0, 0)
# of the plot's upright axis, beyond the commands there are [m/s]
_MARGIN = 0.5
_CURVES: tuple[uplot.Series, ...] = (
    {"label": "spring-mass model", "stroke": MODEL, "width": 1.5},
    {"label": "Cassie", "stroke": ROBOT, "width": 2.0},
    {"label": "command", "stroke": COMMAND, "width": 1.5, "dash": (6.0, 4.0)},
)
# the paper's terms in its order; others follow
_ORDER = {name: i for i, name in enumerate(PAPER_WEIGHTS)}
_TERM_COLOR, _TOTAL_COLOR, _ALARM_COLOR = "#9aa5b8", "#333d52", "#c92a2a"


@dataclass(frozen=True)
class Status:
    """What is told in lines of text."""

    time: float
    """Since the last reset [s]."""
    speed: float
    """Of the pelvis, forward [m/s]."""
    height: float
    """Of the pelvis [m]."""
    distance: float
    """Walked along x since the last reset [m]."""
    falls: int
    """Since the page was opened."""
    factor: float | None
    """Simulated over real time; None while time stands still."""
    message: str
    """What a person should know just now; may be empty."""


class Readouts:
    """Numbers, bars and a plot.

    Args:
        gui: of the server, within the panel where they are to be.
        speeds: lowest and highest command [m/s], for the plot's axis.
    """

    def __init__(self, gui: viser.GuiApi, speeds: tuple[float, float]) -> None:
        points = round(PLOT_SPAN / POLICY_PERIOD)
        self._time = POLICY_PERIOD * np.arange(1 - points, 1)
        self._history: deque[tuple[float, float, float]] = deque(maxlen=points)
        self._reward: dict[str, float] = {}
        self._lines = gui.add_html("")
        self._plot = gui.add_uplot(
            self._curves(),
            ({"label": "time"}, *_CURVES),
            scales={
                "x": {"time": False, "range": (-PLOT_SPAN, 0.0)},
                "y": {"range": (speeds[0] - _MARGIN, speeds[1] + _MARGIN)},
            },
            axes=({"label": "time [s]"}, {"label": "forward speed [m/s]"}),
            legend={"live": False},
            height=_PLOT_HEIGHT,
            padding=_PLOT_PADDING,
        )
        self._bars = gui.add_html("")

    def add(self, td: TensorDictBase) -> None:
        """Take note of a policy step, as `Walker.step` returns it."""
        after = cast("TensorDictBase", td["next"])
        speed = after["truth", "pelvis_velocity"][0, 0]
        reference = after["reference", "body_velocity"][0, 0]
        self._history.append((float(reference), float(speed), float(td["command"])))
        terms = cast("TensorDictBase", after["reward_terms"])
        names = sorted(terms.keys(), key=lambda name: _ORDER.get(name, len(_ORDER)))
        self._reward = {name: float(terms[name]) for name in names}
        self._reward["reward"] = float(after["reward"])

    def show(self, status: Status) -> None:
        """Bring what is shown up to date; meant for a few times a second."""
        self._lines.content = _lines(status)
        self._plot.data = self._curves()
        self._bars.content = _bars(self._reward)

    def _curves(self) -> tuple[np.ndarray, ...]:
        """Time before the present [s] and the speeds [m/s] then, each (n,)."""
        count = len(self._history)
        columns = np.array(self._history, dtype=np.float64).reshape(count, len(_CURVES)).T
        return (self._time[len(self._time) - count :], *columns)


def _lines(status: Status) -> str:
    factor = "paused" if status.factor is None else f"real-time factor {status.factor:.2f}"
    entries = (
        ("time", f"{status.time:.2f} s", factor),
        ("forward speed", f"{status.speed:.2f} m/s", f"{status.distance:.2f} m along x"),
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
    """Values from 0 to 1 by name, each with a bar."""
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
