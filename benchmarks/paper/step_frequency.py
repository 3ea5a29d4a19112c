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


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aslip.base.tables import markdown
from aslip.library.footholds import Footholds
from aslip.robot import CASSIE
from aslip.walking import Walks
from aslip.walking.metrics import duty_factor, step_frequency
from benchmarks.common import (
    Interval,
    MakeEnv,
    Policy,
    constant_walks,
    load_with_library,
    shortest_swing,
    strides,
    write_report,
)

# durations of settling and of the measurement [s]
_SETTLE, _WALK = 4.0, 16.0


def main(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> list[dict[str, Any]]:
    """Measure, print and draw; returns a row for each speed.

    Args:
        config: the settings.
        policy: policy to measure; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    subjects, library = load_with_library(config, policy, make_env)
    model = 2 / strides(library, config.speeds)
    walks = constant_walks(config, subjects, config.speeds, _SETTLE + _WALK)
    first = round(_SETTLE / CASSIE.policy_period)
    rows: list[dict[str, Any]] = []
    footholds = Footholds(library)
    for i, speed in enumerate(config.speeds):
        swing = shortest_swing(footholds, speed)
        found = [frequency_and_duty(walk.one(i, first), swing) for walk in walks]
        frequency = Interval.of([np.array([f]) for f, _ in found])
        rows.append(
            {
                "speed": speed,
                "model": float(model[i]),
                **vars(frequency),
                "off": frequency.mean / float(model[i]) - 1,
                "each": [f / float(model[i]) - 1 for f, _ in found],
                "duty": float(np.mean([duty for _, duty in found])),
            }
        )
    cells = [
        [
            f"{row['speed']:.1f}",
            f"{row['model']:.3f}",
            f"{row['mean']:.3f}",
            f"{100 * row['off']:+.2f} %",
            f"{row['duty']:.2f}",
        ]
        for row in rows
    ]
    header = ["command [m/s]", "model [Hz]", "robot [Hz]", "error", "duty factor"]
    write_report(
        config, policy, "step_frequency", {"rows": rows}, markdown(header, cells), picture(rows)
    )
    return rows


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
    axis.plot(speeds, [row["model"] for row in rows], color="tab:gray", lw=3, label="model")
    axis.plot(speeds, [row["mean"] for row in rows], "o", color="tab:red", label="robot")
    axis.set(xlabel="commanded speed [m/s]", ylabel="step frequency [Hz]")
    axis.grid(alpha=0.3)
    axis.legend()
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
