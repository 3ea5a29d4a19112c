"""Draw the pictures of the glossary: frames and stack.

python docs/diagrams.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc, Circle, FancyBboxPatch

IMAGES: Final = Path(__file__).parent / "images"

_BOTH, _SIMULATED, _OTHER = "#d6e6f5", "#fbe3cb", "#e6e6e6"
_INK, _FAINT = "#222222", "#777777"
_HEADING, _PELVIS, _PATH = "#1b8a7a", "#d2780f", "#8e5bb5"

_AROUND: Final = {
    "command": (9, 58, "draws it", _SIMULATED),
    "command_filter": (28.5, 58, "limits its rate:\nfiltered_command", _BOTH),
    "clock": (48, 58, "phase, and mode by\nthe estimate", _BOTH),
    "reference": (67, 58, "looks up reference\nand target", _BOTH),
    "feedforward": (88, 58, "motor target that\ncarries the load", _BOTH),
    "stand": (48, 72, "draws stand\ncommand", _SIMULATED),
    "last_action": (9, 38, "of the step before", _BOTH),
    "observation": (28.5, 38, "joins its entries", _BOTH),
    "action": (67, 38, "added to the\nmotor target", _BOTH),
    "estimator": (28.5, 18, "estimate,\nodometry", _BOTH),
    "noise": (67, 18, "noise of the\nsensors", _SIMULATED),
    "heading": (67, 0, "true_odometry, in\nthe heading frame", _SIMULATED),
    "reward": (9, 0, "weighted sum", _SIMULATED),
}
"""Transform -> place of its box, what it does, colour."""

REWARD_TERMS: Final = (
    ("com_vel", "foot_pos", "foot_orient", "action_diff", "straight_diff"),
    ("path_diff", "heading_diff", "power", "landing", "squeeze"),
)
"""Terms of all stacks, or of the straight ones; terms of all directions alone."""

_ENDS: Final = ("fall", "low_reward", "step_limit")
_RECORDS: Final = ("start", "first_step", "episode_sum")

NAMES: Final = {*_AROUND, *sum(REWARD_TERMS, ()), *_ENDS, *_RECORDS}
"""Transforms of the picture, by their names in a stack."""

_DIRECTIONS: Final = ("command_filter", "stand")  # with a dashed border


def draw_stack(path: Path) -> None:
    """Draw data flow and transforms of the stacks, straight and in all directions."""
    figure, axes = plt.subplots(figsize=(10, 7.6))
    for name, (x, y, does, colour) in _AROUND.items():
        _box(axes, (x, y), name, does, colour, dashed=name in _DIRECTIONS)
    _box(axes, (48, 38), "policy", "network", _OTHER)
    _box(axes, (88, 38), "robot", "drive and sensors\nat 2 kHz", _OTHER)
    terms = "\n".join(", ".join(row) for row in (REWARD_TERMS[0][:3], REWARD_TERMS[0][3:]))
    more = "\n".join(", ".join(row) for row in (REWARD_TERMS[1][:3], REWARD_TERMS[1][3:]))
    _box(axes, (37, 0), "reward terms", f"{terms}\n{more}", _SIMULATED, size=(29, 15))
    _box(axes, (28, -17), ", ".join(_ENDS), "end an episode", _SIMULATED, size=(44, 8))
    _box(axes, (75, -17), ", ".join(_RECORDS), "begin and record it", _SIMULATED, size=(44, 8))

    for start, end in (((16.5, 58), (21, 58)), ((36, 58), (40.5, 58)), ((48, 67.5), (48, 62.5)),
                       ((55.5, 58), (59.5, 58)), ((74.5, 58), (80.5, 58)), ((16.5, 38), (21, 38)),
                       ((36, 38), (40.5, 38)), ((55.5, 38), (59.5, 38)), ((74.5, 38), (80.5, 38)),
                       ((59.5, 18), (36, 18)), ((28.5, 22.5), (28.5, 33.5)),
                       ((59.5, 0), (51.5, 0)), ((22.5, 0), (16.5, 0))):  # fmt: skip
        _arrow(axes, start, end)
    _path(axes, [(63, 53.5), (63, 47), (32, 47), (32, 42.5)], "reference, phase", (47.5, 48))
    _path(axes, [(88, 53.5), (88, 47), (71, 47), (71, 42.5)], "motor target", (79.5, 48))
    _path(axes, [(85, 33.5), (85, 18), (74.5, 18)], "sensors", (84.5, 24), ha="right")
    _path(axes, [(91, 33.5), (91, 0), (74.5, 0)], "truth", (90.5, 8), ha="right")
    axes.text(48, 19, "sensors with noise", ha="center", fontsize=9, color=_FAINT)
    legend = {"also in the controller of a robot": (2, _BOTH)}
    legend |= {"in simulation only": (39, _SIMULATED), "no transform": (62, _OTHER)}
    for text, (x, colour) in legend.items():
        axes.add_patch(FancyBboxPatch((x, 82), 2.5, 2.5, "round,pad=0.2", fc=colour, ec=_INK))
        axes.text(x + 4, 83.2, text, va="center", fontsize=10)
    axes.text(79, 83.2, "dashed: all directions", va="center", fontsize=10)
    axes.set(xlim=(0, 98), ylim=(-22, 87))
    _save(figure, axes, path)


def draw_frames(path: Path) -> None:
    """Draw world, moving frame and pelvis frame, from above and from the side."""
    figure, (above, side) = plt.subplots(
        1, 2, figsize=(10, 4.3), gridspec_kw={"width_ratios": [1.5, 1]}
    )
    _from_above(above)
    _from_the_side(side)
    for axes in (above, side):
        axes.set_aspect("equal")
        axes.axis("off")
    _save(figure, above, path)


def _from_above(axes: Any) -> None:
    """Path of a command with a turn, the frame on it, and a robot beside it."""
    radius, yaw = 3.4, np.radians(40)
    place = radius * np.array([np.sin(yaw), 1 - np.cos(yaw)])
    axes.add_patch(Arc((0, radius), 2 * radius, 2 * radius, theta1=-90, theta2=-18, color=_FAINT))
    axes.text(3.3, 1.75, "path of the\nfiltered command", fontsize=9, color=_FAINT)
    _frame(axes, np.zeros(2), 0.0, "#444444", "world", (-0.15, -0.3))
    _frame(axes, place, yaw, _HEADING, "heading frame\n(moving frame)", (0.2, -0.5))
    pelvis = place + _turned(yaw, [-0.6, 1.05])
    _frame(axes, pelvis, yaw + 0.3, _PELVIS, "pelvis frame", (-0.9, 0.45), length=0.5)
    axes.plot(*np.stack([place, pelvis]).T, ":", color=_PATH, lw=2)
    axes.text(0.95, 0.47, "path_error,\npulled in by\nthe leash", fontsize=9, color=_PATH)
    axes.plot([place[0], place[0] + 0.85], [place[1], place[1]], "--", color=_FAINT, lw=1)
    axes.add_patch(Arc(tuple(place), 1.2, 1.2, theta1=0, theta2=40, color=_INK))
    axes.text(place[0] + 0.67, place[1] + 0.16, "heading", fontsize=9)
    axes.set(xlim=(-0.3, 4.4), ylim=(-0.4, 2.5), title="from above")


def _from_the_side(axes: Any) -> None:
    """Pelvis with its frame above the floor, and the frame below it."""
    axes.plot([-0.8, 1.5], [0, 0], color=_FAINT)
    axes.text(1.5, -0.05, "floor", ha="right", va="top", fontsize=9, color=_FAINT)
    leg = [[0.2, 1.15], [0.45, 0.75], [-0.02, 0.4], [0.3, 0.02]]
    axes.plot(*np.array(leg).T, color="#bbbbbb", lw=5, zorder=0)
    axes.plot([0.2, 0.44], [0.02, 0.02], color="#bbbbbb", lw=6, zorder=0)
    axes.add_patch(Circle((0.2, 1.15), 0.12, color="#bbbbbb", zorder=0))
    about = "heading frame:\nz up, against gravity"
    _frame(axes, np.array([-0.3, 0]), 0.0, _HEADING, about, (-0.4, -0.4), names="xz")
    about = "pelvis frame:\nturns with the robot"
    _frame(axes, np.array([0.2, 1.15]), -0.2, _PELVIS, about, (0.25, 0.25), 0.5, "xz")
    axes.annotate("", (0.9, 0), (0.9, 1.15), arrowprops={"arrowstyle": "<->", "color": _FAINT})
    axes.text(0.95, 0.5, "height", fontsize=9, color=_FAINT)
    axes.set(xlim=(-0.9, 1.6), ylim=(-0.42, 1.9), title="from the side")


def _turned(angle: float, vector: Any) -> Any:
    """Vector (2,) turned to the left by an angle [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]]) @ np.asarray(vector)


def _frame(
    axes: Any, origin: Any, angle: float, colour: str, name: str, offset: tuple[float, float],
    length: float = 0.75, names: str = "xy",
) -> None:  # fmt: skip
    """Draw the two axes of a frame, and its name beside the origin."""
    for axis, direction in zip(names, ([length, 0], [0, length]), strict=True):
        tip = origin + _turned(angle, direction)
        axes.annotate("", tip, origin, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})
        beyond = origin + 1.13 * _turned(angle, direction)
        axes.text(
            *beyond,
            axis,
            color=colour,
            ha="center",
            va="center",
            fontsize=10,
            bbox={"fc": "white", "ec": "none", "pad": 0.8},
        )
    axes.plot(*origin, "o", color=colour, ms=5)
    axes.text(*(origin + np.array(offset)), name, color=colour, fontsize=10, va="bottom")


def _box(
    axes: Any, centre: tuple[float, float], name: str, text: str, colour: str, *,
    size: tuple[float, float] = (15, 9), dashed: bool = False,
) -> None:  # fmt: skip
    """Draw a box with a name and what it does."""
    (x, y), (width, height) = centre, size
    corner = (x - width / 2, y - height / 2)
    style = "dashed" if dashed else "solid"
    axes.add_patch(
        FancyBboxPatch(corner, width, height, "round,pad=0.3", fc=colour, ec=_INK, ls=style)
    )
    axes.text(x, y + height / 2 - 0.6, name, ha="center", va="top", family="monospace",
              fontsize=10, weight="bold")  # fmt: skip
    axes.text(x, y - 1.2, text, ha="center", va="center", fontsize=8.5)


def _arrow(axes: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw an arrow between two points."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": _INK, "lw": 1.3})


def _path(
    axes: Any, corners: list[tuple[float, float]], text: str, place: tuple[float, float],
    ha: str = "center",
) -> None:  # fmt: skip
    """Draw an arrow around corners, with the name of what it carries."""
    axes.plot(*np.array(corners[:-1]).T, color=_INK, lw=1.3, solid_capstyle="butt")
    _arrow(axes, corners[-2], corners[-1])
    axes.text(*place, text, ha=ha, fontsize=9, color=_FAINT)


def _save(figure: Any, axes: Any, path: Path) -> None:
    """Write the picture and close it."""
    axes.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    plt.switch_backend("agg")
    draw_frames(IMAGES / "frames.png")
    draw_stack(IMAGES / "stack.png")
