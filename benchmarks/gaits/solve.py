"""Gaits in several directions: their table with certificates, and their paths from above.

    python -m benchmarks.gaits.solve --picture docs/images/directions.png

Each gait is solved from the rough guess. Its constraints that bind, apart from the least force of
the leg, tell which bounds shape it. Time is processor time of solver and certificate; that of the
first gait includes the derivatives of the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from aslip.rom import DIRECTION_MODEL, Objective, SlipParameters

DIRECTIONS = (
    (1.0, 0.0, 0.0),
    (0.0, 0.5, 0.0),
    (0.0, 0.0, 1.0),
    (1.0, 0.0, 1.0),
    (1.0, 0.3, -0.5),
    (-0.8, 0.2, 0.5),
)


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    commands: tuple[tuple[float, float, float], ...] = DIRECTIONS
    """Forward speed, sideways speed [m/s] and yaw rate [rad/s] of each gait."""
    model: SlipParameters = DIRECTION_MODEL
    """Model and bounds of the gaits."""
    objective: Objective = "mean"
    """Minimised quantity: the mean of u_l^2 + u_r^2 over the stride, or its integral."""
    picture: Path = Path("directions.png")
    """File of the picture."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import time

from aslip.base.tables import markdown
from aslip.rom import Gait, optimize_gait
from aslip.show.gait_paths import path_figure
from aslip.show.plots import save_figure

_BINDING = 1e-5
"""Margin below which a constraint binds [units of the constraint]."""


def main(config: Config) -> list[Gait]:
    """Optimise, print and draw; returns the gaits."""
    gaits, rows = [], []
    for command in config.commands:
        start = time.process_time()
        gait = optimize_gait(command, parameters=config.model, objective=config.objective)
        rows.append([*_numbers(gait), f"{time.process_time() - start:.2f}", _binding(gait)])
        gaits.append(gait)
    header = (
        "forward, sideways [m/s], yaw rate [rad/s]", "stride [s]", "cost [m²/s⁴]",
        "largest force / weight", "KKT", "integration [mm]", "time [s]", "binding",
    )  # fmt: skip
    print(markdown(header, rows, [*["---:"] * 7, "---"]))
    save_figure(path_figure(gaits), config.picture)
    print(f"\npicture: {config.picture}")
    return gaits


def _numbers(gait: Gait) -> list[str]:
    certificate = gait.certificate
    return [
        ", ".join(f"{number:g}" for number in gait.command),
        f"{gait.stride:.3f}",
        f"{certificate.cost:.0f}",
        f"{gait.leg_force.max() / gait.parameters.weight:.2f}",
        f"{certificate.kkt_residual:.0e}",
        f"{1e3 * certificate.integration_error:.4f}",
    ]


def _binding(gait: Gait) -> str:
    """Kinds of constraints that bind, apart from the least force of the leg."""
    close = [name for name, margin in gait.certificate.margins.items() if margin < _BINDING]
    kinds = dict.fromkeys(name.split(",")[0] for name in close)
    return ", ".join(kind for kind in kinds if kind != "leg force") or "none"


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
