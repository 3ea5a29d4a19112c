"""Step frequency of the robot against that of the reduced-order model, at each speed.

python -m benchmarks.paper.step_frequency --policy runs/seed0 runs/seed1 runs/seed2
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import WithLibrary


@dataclass(frozen=True)
class Config(WithLibrary):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = tuple(i / 10 for i in range(21))
    """Commanded speeds [m/s]."""
    settle: float = 4.0
    """Time at the start that is not measured [s]."""
    walk: float = 16.0
    """Duration of the measurement [s]."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.library.footholds import Footholds
from aslip.robot import CASSIE
from aslip.show.palette import MODEL, ROBOT
from aslip.walking import Walks
from aslip.walking.metrics import duty_factor, step_frequency
from benchmarks.common import (
    Policies,
    Report,
    benchmark,
    constant_walks,
    shortest_swing,
    straight,
    table,
)

COLUMNS = {
    "command [m/s]": "{speed:.1f}",
    "model [Hz]": "{model:.3f}",
    "robot [Hz]": "{mean:.3f}",
    "error": lambda row: f"{100 * row['off']:+.2f} %",
    "duty factor": "{duty:.2f}",
}


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each speed."""
    subjects = policies.load()
    library = subjects[0].library
    walks = constant_walks(config, subjects, config.speeds, config.settle + config.walk)
    first = round(config.settle / CASSIE.policy_period)
    rows: list[dict[str, Any]] = []
    footholds = Footholds(library)
    for i, speed in enumerate(config.speeds):
        command = torch.tensor([straight(library, speed)], dtype=torch.float64)
        model, swing = 2 / library.stride(command).item(), shortest_swing(footholds, speed)
        found = [frequency_and_duty(walk.one(i, first), swing) for walk in walks]
        frequency = Interval.of([np.array([f]) for f, _ in found])
        rows.append(
            {
                "speed": speed,
                "model": model,
                **vars(frequency),
                "off": frequency.mean / model - 1,
                "duty": float(np.mean([duty for _, duty in found])),
            }
        )
    return Report(rows, table(COLUMNS, rows), picture(rows))


def frequency_and_duty(walk: Walks, swing: float) -> tuple[float, float]:
    """Step frequency [Hz] and duty factor of a walk; NaN after a fall."""
    if not walk.survived[0]:
        return np.nan, np.nan
    left, right = walk.ground_force[:, 0, :, 2].T
    duty = np.mean([duty_factor(force, CASSIE.policy_period, swing) for force in (left, right)])
    return step_frequency(left, right, CASSIE.policy_period, swing), float(duty)


def picture(rows: list[dict[str, Any]]) -> Figure:
    """Step frequency of robot and model over speed."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    speeds = [row["speed"] for row in rows]
    axis.plot(speeds, [row["model"] for row in rows], color=MODEL, lw=3, label="model")
    axis.plot(speeds, [row["mean"] for row in rows], "o", color=ROBOT, label="robot")
    axis.set(xlabel="commanded speed [m/s]", ylabel="step frequency [Hz]")
    axis.grid(alpha=0.3)
    axis.legend()
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
