"""Error of mean velocity and yaw rate over random commands in all directions.

    python -m benchmarks.directions.tracking --policy runs/ppo_directions
    python -m benchmarks.directions.tracking --policy runs/seed0 runs/seed1 --commands 1000

Commands are uniform over the region of the library, without a dead zone. Each is held for 8 s.
Means are taken over the last 4 s, errors over walks without a fall, 95 % intervals over commands.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import Directions


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    commands: int = 200
    """Number of random commands."""

    def __post_init__(self) -> None:
        """Check the number of commands."""
        super().__post_init__()
        if self.commands < 1:
            raise ConfigurationError(f"commands must be 1 or more, got {self.commands}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.robot import CASSIE
from aslip.walking.metrics import mean_twist, tracking_errors
from benchmarks.common import MakeEnv, Policy, load_with_library, record_subject, write_report
from benchmarks.directions.random_commands import AXES, random_commands

# durations of settling and of the measurement [s]
_SETTLE, _WALK = 4.0, 4.0


def main(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> list[dict[str, Any]]:
    """Measure, print and draw; return a row for each policy.

    Args:
        config: the settings.
        policy: policy to measure; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    subjects, library = load_with_library(config, policy, make_env)
    command = random_commands(library, config.commands, config.seed)
    first, steps = (round(t / CASSIE.policy_period) for t in (_SETTLE, _SETTLE + _WALK))
    rows, twists = [], []
    for subject in subjects:
        walks = record_subject(config, subject, np.tile(command, (steps, 1, 1)))
        twist = mean_twist(
            walks.pelvis_velocity[first:], walks.pelvis_orientation[first:], command[:, 2]
        )
        falls = int((~walks.survived).sum())
        errors = tracking_errors(twist, command)
        rows.append(
            {"policy": subject.name, "falls": falls, **{k: vars(one) for k, one in errors.items()}}
        )
        twists.append(twist)
    numbers = {
        "rows": rows, "command": command.tolist(), "twist": [one.tolist() for one in twists]
    }  # fmt: skip
    figure = picture(command, twists[0])
    write_report(config, policy, "tracking", numbers, table(rows, len(command)), figure)
    return rows


def table(rows: list[dict[str, Any]], count: int) -> str:
    """Table of errors, a row for each policy."""
    keys = ("speed", "speed_p95", "turn", "turn_p95")
    lines = [
        [
            row["policy"],
            f"{row['falls']} of {count}",
            *(Interval.of_row(row[key]).text(3) for key in keys),
        ]
        for row in rows
    ]
    header = [
        "policy", "falls", "speed: mean error [m/s]", "95 % [m/s]",
        "yaw rate: mean error [rad/s]", "95 % [rad/s]",
    ]  # fmt: skip
    return markdown(header, lines)


def picture(command: np.ndarray, twist: np.ndarray) -> Figure:
    """Maps of errors over two pairs of command components; crosses are falls."""
    fell = ~np.isfinite(twist).all(axis=1)
    speed = np.linalg.norm((twist - command)[:, :2], axis=1)
    turn = np.abs(twist - command)[:, 2]
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    panels = figure.subplots(2, 2)
    errors = ((speed, "error of speed [m/s]"), (turn, "error of yaw rate [rad/s]"))
    for row, (error, name) in zip(panels, errors, strict=True):
        for axes, other in zip(row, (2, 1), strict=True):
            dots = axes.scatter(
                command[~fell, other], command[~fell, 0], c=error[~fell], s=22, vmin=0, vmax=0.2
            )
            axes.plot(command[fell, other], command[fell, 0], "rx", ms=5, label="fall")
            axes.set(xlabel=AXES[other], ylabel=AXES[0])
            if fell.any():
                axes.legend(loc="upper right", fontsize=8)
        figure.colorbar(dots, ax=row.tolist(), label=name, extend="max")
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
