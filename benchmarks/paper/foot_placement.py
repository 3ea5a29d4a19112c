"""Foot-placement error against the reduced-order model, as in the paper's figure (Sec. V-A).

    python -m benchmarks.paper.foot_placement                  # the policy `straight`
    python -m benchmarks.paper.foot_placement --policy runs/seed0 runs/seed1 runs/seed2

At each speed, consecutive footsteps of the settled walk are measured. The ideal position of each
is the other foot's actual position plus the step of the reduced-order model. The position of a
footstep is the sole centre at mid-stance.

The paper's figure shows one rollout, whose speed saturates at 0.9 m/s: its errors at higher
commands are those of a robot that is too slow. Policies that the paper's authors released are more
precise; both stand beside the measured errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import WithLibrary

PUBLISHED: Final = MappingProxyType(
    {
        0.0: (0.0480, 0.0154), 0.1: (0.0462, 0.0073), 0.2: (0.0435, 0.0039), 0.3: (0.0380, 0.0098),
        0.4: (0.0465, 0.0159), 0.5: (0.0625, 0.0164), 0.6: (0.0535, 0.0060), 0.7: (0.0639, 0.0094),
        0.8: (0.0662, 0.0093), 0.9: (0.0720, 0.0140), 1.0: (0.0922, 0.0169), 1.1: (0.1160, 0.0226),
        1.2: (0.1461, 0.0253), 1.3: (0.1775, 0.0280), 1.4: (0.2098, 0.0282), 1.5: (0.2452, 0.0258),
        1.6: (0.2878, 0.0267), 1.7: (0.3265, 0.0281), 1.8: (0.3625, 0.0350), 1.9: (0.3978, 0.0399),
        2.0: (0.4319, 0.0423),
    }
)  # fmt: skip
"""Speed [m/s] -> mean error and standard deviation in the paper's figure, of one rollout [m]."""

RELEASED: Final = MappingProxyType(
    {
        "aslip_unified_0_v7": {0.0: 0.027, 0.5: 0.055, 1.0: 0.077, 1.5: 0.093, 2.0: 0.134},
        "aslip_unified_task0_v7": {0.0: 0.018, 0.5: 0.045, 1.0: 0.076, 1.5: 0.112, 2.0: 0.135},
    }
)
"""Released policy (osudrl/ASLIP-RL) -> speed [m/s] -> mean error in its own simulator [m]."""


@dataclass(frozen=True)
class Config(WithLibrary):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = tuple(PUBLISHED)
    """Commanded speeds [m/s]."""
    settle: float = 4.0
    """Time at the start whose footsteps are not measured [s]."""
    walk: float = 12.0
    """Duration of the measurement [s]."""
    footsteps: int = 15
    """Number of footsteps that are measured."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.library import Command
from aslip.library.footholds import Footholds
from aslip.robot import CASSIE, SIDES
from aslip.show.palette import COMMAND, ROBOT, SERIES
from aslip.walking import Walks
from aslip.walking.metrics import Placement, footsteps, placement
from benchmarks.common import (
    Policies,
    Report,
    benchmark,
    constant_walks,
    shortest_swing,
    table,
)

Placements = dict[float, list[Placement]]
"""Commanded speed [m/s] -> placements of all policies."""

COLUMNS = {
    "command [m/s]": lambda row: str(round(row["speed"], 3)),
    "error [cm]": lambda row: Interval.of_row(row).text(1, 100),
    "std [cm]": lambda row: f"{100 * row['std']:.1f}",
    "forward [cm]": lambda row: f"{100 * row['forward']:+.1f}",
    "outward [cm]": lambda row: f"{100 * row['outward']:+.1f}",
    "width [cm]": lambda row: f"{100 * row['width']:.1f}",
    "survived": "{survived} of {policies}",
    "published [cm]": lambda row: (
        "" if row["published"] is None else f"{100 * row['published']:.1f}"
    ),
    "released policies [cm]": lambda row: ", ".join(f"{100 * e:.1f}" for e in row["released"]),
}


@benchmark
def main(config: Config, policies: Policies) -> Report[Placements]:
    """Measure and draw; the result is the placements of all policies at each speed."""
    subjects = policies.load()
    footholds = Footholds(subjects[0].library)
    walks = constant_walks(config, subjects, config.speeds, config.settle + config.walk)
    found = {
        speed: [walk_placement(config, walk, i, speed, footholds) for walk in walks]
        for i, speed in enumerate(config.speeds)
    }
    rows = [numbers(speed, placements) for speed, placements in found.items()]
    figure = picture({speed: without_falls(placements) for speed, placements in found.items()})
    return Report(found, table(COLUMNS, rows), figure, {"rows": rows})


def walk_placement(
    config: Config, walk: Walks, index: int, command: Command, footholds: Footholds
) -> Placement:
    """Placement of the footsteps of one settled walk; a single NaN after a fall.

    Args:
        config: the settings.
        walk: walks.
        index: index of the walk.
        command: its command.
        footholds: steps of the model.
    """
    one, swing = walk.one(index), shortest_swing(footholds, command)
    step = np.stack([footholds.step(side, command) for side in SIDES])
    if not one.survived[0]:
        nothing = np.full((1, 2), np.nan)
        return Placement(np.zeros(1, dtype=int), nothing, nothing[:, 0])
    found = placement(
        footsteps(
            one.ground_force[:, 0, :, 2],
            one.foot_place[:, 0],
            CASSIE.policy_period,
            swing,
            one.frame[:, 0, 2],
        ),
        step,
    )
    first = round(2 * config.settle / float(footholds.stride(command)))
    rows = slice(first, first + config.footsteps)
    return Placement(found.side[rows], found.offset[rows], found.width[rows])


def numbers(speed: float, every: Sequence[Placement]) -> dict[str, Any]:
    """Row of the report for one speed, over the policies without a fall."""
    placements = without_falls(every)
    return {
        "speed": speed,
        **vars(Interval.of([p.error for p in placements])),
        "std": _mean(np.std, [p.error for p in placements]),
        "forward": _mean(np.mean, [p.offset[:, 0] for p in placements]),
        "outward": _mean(np.mean, [p.outward for p in placements]),
        "width": _mean(np.mean, [p.width for p in placements]),
        "footsteps": sum(len(p.error) for p in placements),
        "survived": len(placements),
        "policies": len(every),
        "published": published_error(speed),
        "released": released_errors(speed),
    }


def without_falls(placements: Sequence[Placement]) -> list[Placement]:
    """Placements of the walks without a fall."""
    return [p for p in placements if np.isfinite(p.error).all()]


def published_error(speed: float) -> float | None:
    """Published mean error at a speed [m]; None at other speeds."""
    return next((v[0] for k, v in PUBLISHED.items() if abs(k - speed) < 1e-6), None)


def released_errors(speed: float) -> list[float]:
    """Mean errors of the released policies at a speed [m]; empty at other speeds."""
    found = [(k, v) for errors in RELEASED.values() for k, v in errors.items()]
    return [error for known, error in found if abs(known - speed) < 1e-6]


def _mean(statistic: Callable[..., Any], footsteps: Sequence[np.ndarray]) -> float:
    """Mean over policies of a statistic of their footsteps; NaN without footsteps."""
    values = [statistic(value) for value in footsteps if len(value)]
    return float(np.mean(values)) if values else math.nan


def picture(by_speed: dict[float, list[Placement]]) -> Figure:
    """Mean and standard deviation of errors over speed, beside the authors' figure and policies."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    speeds = list(by_speed)
    means = [100 * _mean(np.mean, [p.error for p in ps]) for ps in by_speed.values()]
    spread = [100 * _mean(np.std, [p.error for p in ps]) for ps in by_speed.values()]
    theirs = np.array(list(PUBLISHED.values())).T * 100
    left.errorbar(list(PUBLISHED), *theirs, color=COMMAND, capsize=3, label="paper's figure")
    for i, errors in enumerate(RELEASED.values()):
        name = None if i else "released policies"
        cm = [100 * error for error in errors.values()]
        left.plot(list(errors), cm, "s--", color="black", lw=0.8, ms=4, label=name)
    left.errorbar(speeds, means, spread, color=ROBOT, capsize=3, label="here")
    left.set(xlabel="commanded speed [m/s]", ylabel="foot-placement error [cm]", ylim=(0, None))
    left.legend()
    for name, pick, color in (
        ("forward", lambda p: p.offset[:, 0], SERIES[1]),
        ("outward", lambda p: p.outward, SERIES[2]),
    ):
        means = [100 * _mean(np.mean, [pick(p) for p in ps]) for ps in by_speed.values()]
        right.plot(speeds, means, "o-", color=color, label=name)
    right.axhline(0, color="black", lw=0.8)
    right.set(xlabel="commanded speed [m/s]", ylabel="actual minus ideal position [cm]")
    right.legend()
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
