"""Figures of gaits, learning curves and courses."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.errors import ConfigurationError
from aslip.rom import Gait, Mode
from aslip.show.palette import LEFT, MODEL, RIGHT, SERIES
from aslip.sim.course import Course
from aslip.training.settings import SETTINGS_FILE, read_settings

with extras():
    import matplotlib as mpl
    from cycler import cycler
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from mpl_toolkits.mplot3d.axes3d import Axes3D

History = Mapping[str, Sequence[float] | np.ndarray]
"""Columns of a run's `progress.csv` by name."""

_MODES = {
    Mode.LEFT: (LEFT, "body in left single stance"),
    Mode.RIGHT: (RIGHT, "body in right single stance"),
    Mode.DOUBLE: (MODEL, "body in double stance"),
}
_BODY: dict[str, Any] = {"lw": 2.5}
_FEET: dict[str, dict[str, Any]] = {
    "left foot": {"color": LEFT, "lw": 1.5, "ls": "--"},
    "right foot": {"color": RIGHT, "lw": 1.5, "ls": ":"},
}


def gait_figure(gait: Gait, strides: int = 2) -> Figure:
    """Figure of the paths of body, coloured by contact mode, and feet of a gait.

    Args:
        gait: gait to draw.
        strides: number of strides to draw.
    """
    motion = gait.sample(np.linspace(0.0, strides, 400 * strides, endpoint=False))
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    for mode, points in _pieces(motion.mode, motion.body.position):
        axes.plot(*points.T, color=_MODES[mode][0], **_BODY)
    for path, style in zip(motion.feet.position.swapaxes(0, 1), _FEET.values(), strict=True):
        axes.plot(*path.T, **style)
    span = np.ptp(motion.body.position[:, 0])
    axes.set_box_aspect((max(span, 0.5), 0.45, 1.0), zoom=1.25)  # pyright: ignore[reportArgumentType]
    axes.set(xlabel="x [m]", zlim=(0, 1))
    axes.set_ylabel("y [m]", labelpad=1)
    axes.set_yticks([-0.1, 0.1])
    axes.set_zlabel("z [m]")
    axes.view_init(elev=16, azim=-72)
    figure.legend(handles=_gait_legend(), loc="center left", fontsize=8)
    axes.set_title(f"Optimal actuated-SLIP gait at {round(gait.speed, 3)} m/s")
    return figure


def gait_sheet(gaits: Sequence[Gait]) -> Figure:
    """Figure of all gaits: body height, forward speed, leg forces and swing height over phase."""
    quantities = ("body height [m]", "speed / mean", "leg force [N]", "foot height [m]")
    figure = Figure(figsize=(8.5, 10), layout="constrained")
    rows = figure.subplots(len(quantities), 1, sharex=True)
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.95, len(gaits)))
    phase = np.linspace(0.0, 1.0, 400, endpoint=False)
    for gait, color in zip(gaits, colors, strict=True):
        motion = gait.sample(phase)
        rows[0].plot(phase, motion.body.position[:, 2], color=color)
        if gait.speed > 0:
            rows[1].plot(phase, motion.body.velocity[:, 0] / gait.speed, color=color)
        rows[2].plot(phase, motion.leg_force[:, 0], color=color)
        rows[2].plot(phase, motion.leg_force[:, 1], color=color, ls=":")
        rows[3].plot(phase, motion.feet.position[:, 0, 2], color=color)
        rows[3].plot(phase, motion.feet.position[:, 1, 2], color=color, ls=":")
    for axes, quantity in zip(rows, quantities, strict=True):
        axes.set_ylabel(quantity)
        axes.grid(alpha=0.3)
        _shade_modes(axes, gaits[0])
    rows[2].plot([], [], "k-", label="left leg")
    rows[2].plot([], [], "k:", label="right leg")
    # placed over the swing of the left leg, between the force humps of the right leg
    rows[2].legend(loc="upper center", bbox_to_anchor=(0.2, 1.0), fontsize=8)
    rows[-1].set(xlabel="phase (0: left lift-off)", xlim=(0, 1))
    scale = ScalarMappable(
        Normalize(gaits[0].speed, gaits[-1].speed), ListedColormap([tuple(c) for c in colors])
    )
    figure.colorbar(scale, ax=rows, label="mean speed [m/s]", aspect=50)
    rows[0].set_title(f"{len(gaits)} optimal gaits; double stance of the first one shaded")
    return figure


def learning_curve(history: History, title: str) -> Figure:
    """Figure of episode length, return and reward terms over policy steps.

    Args:
        history: columns of a run's `progress.csv`.
        title: title of the figure.
    """
    steps = np.asarray(history["step"]) / 1e6
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        axes.set_prop_cycle(cycler(ls=_DASHES[:2]) * cycler(color=SERIES))
    left.plot(steps, history["episode_length"], label="training episode length")
    left.plot(steps, history["episode_return"], label="training return")
    evaluated = ~np.isnan(history["eval_return"])
    for name, label in (("eval_return", "evaluation return"), ("eval_length", "evaluation length")):
        left.plot(steps[evaluated], np.asarray(history[name])[evaluated], "o-", ms=4, label=label)
    left.set(xlabel="policy steps [million]", title=title)
    left.legend(fontsize=8, loc="lower right")
    for name, values in history.items():
        if name.startswith("term_"):
            right.plot(steps, values, label=name.removeprefix("term_"))
    right.set(xlabel="policy steps [million]", title="mean reward terms in training")
    right.legend(fontsize=8, loc="lower right")
    for axes in (left, right):
        _from_zero(axes)
        axes.grid(alpha=0.3)
    return figure


def compare_learning(folders: Mapping[str, Sequence[History | str | Path]]) -> Figure:
    """Figure of several trainings: mean over seeds, and range from the worst to the best seed.

    A curve ends where the shortest training of its group ends. Panels without any value, such as
    evaluations that never took place, are left out. Returns of trainings with different rewards
    are marked as such: they do not compare.

    Args:
        folders: name of a group, such as a variant -> run folder of each seed, or its columns of
            `progress.csv`, of which only the names of the reward terms tell rewards apart.

    Raises:
        ConfigurationError: no training has any progress.
        FileDamagedError: the settings of a run cannot be read.
    """
    differ = len({_reward(run) for runs in folders.values() for run in runs} - {()}) > 1
    groups = {
        name: [run for run in map(_history, runs) if len(run.get("step", ()))]
        for name, runs in folders.items()
    }
    panels = [
        (column, label)
        for column, label in _COMPARED.items()
        if any(np.isfinite(run[column]).any() for runs in groups.values() for run in runs)
    ]
    if not panels:
        raise ConfigurationError(f"the trainings {[*groups]} have no progress yet")
    figure = Figure(figsize=(1 + 4 * len(panels), 4), layout="constrained")
    for axes, (column, label) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        for i, (name, runs) in enumerate(groups.items()):
            if runs:
                # beyond five curves, the same colours dashed
                style = {"color": SERIES[i % len(SERIES)], "ls": _DASHES[i // len(SERIES) % 3]}
                _draw_seeds(axes, name, style, column, runs)
        if differ and "return" in column:
            label += ", each of its own reward"
        axes.set(xlabel="policy steps [million]", ylabel=label, xlim=(0, None))
        _from_zero(axes)
        axes.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=8)
    return figure


_DASHES = ("-", "--", ":")
_COMPARED = {
    "episode_length": "training episode length",
    "episode_return": "training return",
    "eval_return": "evaluation return",
}


def _from_zero(axes: Axes) -> None:
    """Let the vertical axis contain zero and all that is drawn."""
    low, high = axes.get_ylim()
    axes.set_ylim(0 if axes.dataLim.ymin >= 0 else low, max(high, 0))


def _history(run: History | str | Path) -> History:
    if not isinstance(run, str | Path):
        return run
    from aslip.training.progress import read_progress  # needs loggers, and figures do not

    return read_progress(Path(run))


def _reward(run: History | str | Path) -> tuple[str, ...]:
    """Description of the reward of a training: its transforms, or the names of its terms.

    Empty for a training that has not started.
    """
    if not isinstance(run, str | Path):
        return tuple(sorted(name for name in run if name.startswith("term_")))
    if not (Path(run) / SETTINGS_FILE).is_file():
        return ()
    described = read_settings(Path(run))[1].values()
    return tuple(sorted(text for text in described if text.startswith(("Reward", "WeightedR"))))


def _draw_seeds(
    axes: Axes, label: str, style: dict[str, Any], column: str, runs: Sequence[History]
) -> None:
    """Draw mean and range of a column over seeds, at the steps of the shortest run."""
    known = [np.isfinite(run[column]) for run in runs]
    if not all(values.any() for values in known):
        return
    curves = [
        (np.asarray(run["step"])[at] / 1e6, np.asarray(run[column])[at])
        for run, at in zip(runs, known, strict=True)
    ]
    steps = min((curve[0] for curve in curves), key=lambda steps: steps[-1])
    values = np.stack([np.interp(steps, *curve) for curve in curves])
    marker = "o" if column == "eval_return" else ""
    axes.plot(steps, values.mean(0), marker=marker, ms=3, label=label, **style)
    color = style["color"]
    axes.fill_between(steps, values.min(0), values.max(0), alpha=0.25, lw=0, color=color)


def course_figure(courses: Mapping[str, Course]) -> Figure:
    """Figure of courses from above, by their names; colours are heights."""
    figure = Figure(figsize=(10, 0.6 + 1.3 * len(courses)), layout="constrained")
    rows = figure.subplots(len(courses), 1, squeeze=False)[:, 0]
    highest = max(max(abs(c.stones[:, 2]).max() for c in courses.values()), 0.1)
    for axes, (name, course) in zip(rows, courses.items(), strict=True):
        stones = PolyCollection(course.corners, edgecolor="k", lw=0.5, cmap="RdBu_r")
        stones.set(array=course.stones[:, 2], clim=(-highest, highest))
        axes.add_collection(stones)
        for i, (x, y) in enumerate(course.stones[1:-1, :2], start=1):
            axes.text(x, y, str(i), ha="center", va="center", fontsize=6)
        axes.plot(0, 0, marker=">", color="k")
        axes.set(title=name, ylabel="y [m]")
        axes.set_aspect("equal")
        axes.autoscale_view()
    rows[-1].set_xlabel("x [m]")
    figure.colorbar(rows[0].collections[0], ax=list(rows), label="height [m]")
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure."""
    path = user_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _pieces(mode: np.ndarray, points: np.ndarray) -> list[tuple[Mode, np.ndarray]]:
    """Pieces of equal mode; each ends at the first point of the next, so the path has no gaps."""
    breaks = [0, *(np.flatnonzero(np.diff(mode)) + 1), len(mode)]
    return [(Mode(mode[a]), points[a : b + 1]) for a, b in itertools.pairwise(breaks)]


def _shade_modes(axes: Axes, gait: Gait) -> None:
    single = gait.single_stance / gait.stride
    for start in (single, 0.5 + single):
        axes.axvspan(start, start + 0.5 - single, color="0.9", zorder=0)


def _gait_legend() -> list[Line2D]:
    body = [Line2D([], [], color=color, label=label, **_BODY) for color, label in _MODES.values()]
    return body + [Line2D([], [], label=label, **style) for label, style in _FEET.items()]
