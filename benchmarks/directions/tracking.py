"""Error of mean velocity and yaw rate over random commands in all directions.

    python -m benchmarks.directions.tracking --policy runs/ppo_directions
    python -m benchmarks.directions.tracking --policy runs/seed0 runs/seed1 --commands 1000

Commands are uniform over the region of the library, without a dead zone, one for each walk. Means
exclude the time of settling; errors are over walks without a fall, 95 % intervals over commands.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Directions, check_numbers


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    commands: int = 200
    """Number of random commands."""
    settle: float = 4.0
    """Time at the start that is not measured [s]."""
    walk: float = 4.0
    """Duration of the measurement [s]."""

    def __post_init__(self) -> None:
        """Check the number of commands."""
        super().__post_init__()
        check_numbers(self, commands=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.robot import CASSIE
from aslip.walking.metrics import mean_twist, tracking_errors
from benchmarks.common import Policies, Report, benchmark, record_subject, table
from benchmarks.directions.random_commands import AXES, random_commands

COLUMNS = {
    "policy": "{policy}",
    "falls": "{falls} of {count}",
    **{
        header: lambda row, name=name: Interval.of_row(row[name]).text(3)
        for header, name in {
            "speed: mean error [m/s]": "speed",
            "95 % [m/s]": "speed_p95",
            "yaw rate: mean error [rad/s]": "turn",
            "95 % [rad/s]": "turn_p95",
        }.items()
    },
}


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each policy."""
    subjects = policies.load()
    command = random_commands(subjects[0].library, config.commands, config.seed)
    times = config.settle, config.settle + config.walk
    first, steps = (round(time / CASSIE.policy_period) for time in times)
    rows, twists = [], []
    for subject in subjects:
        walks = record_subject(config, subject, np.tile(command, (steps, 1, 1)))
        twist = mean_twist(
            walks.pelvis_velocity[first:], walks.pelvis_orientation[first:], command[:, 2]
        )
        counts = {"falls": int((~walks.survived).sum()), "count": len(command)}
        errors = {name: vars(one) for name, one in tracking_errors(twist, command).items()}
        rows.append({"policy": subject.name, **counts, **errors})
        twists.append(twist.tolist())
    numbers = {"rows": rows, "command": command.tolist(), "twist": twists}
    return Report(rows, table(COLUMNS, rows), picture(command, np.array(twists[0])), numbers)


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
            axes.plot(command[fell, other], command[fell, 0], "kx", ms=5, label="fall")
            axes.set(xlabel=AXES[other], ylabel=AXES[0])
            axes.locator_params(axis="x", nbins=6)
            if fell.any():
                axes.legend(loc="upper right", fontsize=8)
        figure.colorbar(dots, ax=row.tolist(), label=name, extend="max")
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
