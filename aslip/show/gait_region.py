"""Picture of a library's region: cost, duty factor and step width over the commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from aslip.base.imports import extras
from aslip.rom import Gait

with extras():
    from matplotlib.figure import Figure

_QUANTITIES: Final[dict[str, Callable[[Gait], float]]] = {
    "cost [m²/s⁴]": lambda gait: gait.certificate.cost,
    "duty factor": lambda gait: gait.duty_factor,
    "step width [m]": lambda gait: gait.step_width,
}
_PANELS = 4


def region_figure(gaits: Sequence[Gait], left_out: Sequence[np.ndarray]) -> Figure:
    """Figure of cost, duty factor and step width, a row each, over forward speed and yaw rate.

    Columns are up to four of the sideways speeds to the left.

    Args:
        gaits: gaits whose commands are points of a grid of three axes.
        left_out: (3,) commands without a gait, marked with a cross.
    """
    commands = np.array([gait.command for gait in gaits])
    columns = _spread(commands[:, 1])
    figure = Figure(figsize=(1.2 + 2.6 * len(columns), 7.4), layout="constrained")
    panels = figure.subplots(
        len(_QUANTITIES), len(columns), squeeze=False, sharex=True, sharey=True
    )
    forward, yaw_rates = np.unique(commands[:, 0]), np.unique(commands[:, 2])
    for row, (name, quantity) in zip(panels, _QUANTITIES.items(), strict=True):
        values = np.array([quantity(gait) for gait in gaits])
        for axes, speed in zip(row, columns, strict=True):
            cells = np.full((len(yaw_rates), len(forward)), np.nan)
            here = np.isclose(commands[:, 1], speed)
            place = np.searchsorted(yaw_rates, commands[here, 2])
            cells[place, np.searchsorted(forward, commands[here, 0])] = values[here]
            mesh = axes.pcolormesh(
                forward, yaw_rates, cells, shading="nearest", vmin=values.min(), vmax=values.max()
            )
            gaps = np.array([c for c in left_out if np.isclose(c[1], speed)]).reshape(-1, 3)
            axes.plot(gaps[:, 0], gaps[:, 2], "x", color="0.4", ms=4)
        figure.colorbar(mesh, ax=row, label=name)
        row[0].set_ylabel("yaw rate [rad/s]")
    for axes, speed in zip(panels[0], columns, strict=True):
        axes.set_title(f"{speed:g} m/s sideways", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("forward speed [m/s]")
    return figure


def _spread(sideways: np.ndarray) -> np.ndarray:
    """Some values to the left, the smallest and the largest included."""
    left = np.unique(sideways[sideways >= 0])
    return left[np.unique(np.linspace(0, len(left) - 1, _PANELS).round().astype(int))]
