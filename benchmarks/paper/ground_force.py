"""Vertical ground force over a stride: robot, reduced-order model and baseline.

    python -m benchmarks.paper.ground_force  # the policy `straight`
    python -m benchmarks.paper.ground_force --policy ASLIP=runs/default-{1,2} baseline=runs/b-1

Each policy is a method of its own; `name=` before several policies makes them seeds of one method.
The paper's figure has 0, 1 and 2 m/s. Forces are sampled by the physics at 2 kHz. Spring-mass
walking has two humps per stance; walking at a constant body height has one. The dip ratio is the
lowest force between the humps over the peak of the lower hump, after two passes of a 30 ms moving
average.

The default stack feeds the model's leg forces forward, the paper's does not: forces of policies
with the default stack are partly an input (`benchmarks.paper.open_loop_force`).
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import WithLibrary


@dataclass(frozen=True)
class Config(WithLibrary):
    """Settings of the benchmark."""

    speeds: tuple[float, ...] = (0.0, 1.0, 2.0)
    """Commanded speeds [m/s]."""
    settle: float = 4.0
    """Time at the start that is not measured [s]."""
    walk: float = 8.0
    """Duration of the measurement [s]."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from itertools import chain
from typing import Any, Final

import numpy as np
import torch
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.base.tables import markdown
from aslip.library import GaitLibrary
from aslip.library.footholds import touchdown_phases
from aslip.robot import CASSIE
from aslip.rom import Gait, Motion
from aslip.show.palette import SERIES
from aslip.walking import Walker
from aslip.walking.metrics import force_profile, mean_over_strides
from aslip.walking.metrics.contact import stances
from aslip.walking.metrics.force import ForceProfile, dip_ratio, humps
from benchmarks.common import (
    Policies,
    Report,
    Subject,
    benchmark,
    nearest_motion,
)

VERTICAL: Final = (-4, -1)
"""Columns of both feet's vertical force in `watched`."""

_SAMPLES = 200
# smallest number of stances of a foot with which a robot counts as stepping
_LEAST_STANCES = 3


@dataclass(frozen=True)
class Curve:
    """Force of the left foot over a stride from its touchdown, k samples."""

    mean: np.ndarray
    """(k,) mean over strides [N]."""
    std: np.ndarray
    """(k,) standard deviation over strides [N]."""


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each method, policy and speed.

    The model is that of the first method's gaits.

    Raises:
        ConfigurationError: a policy follows gaits in all directions.
    """
    methods = policies.methods()
    check_straight([subject for subjects in methods.values() for subject in subjects])
    library = next(iter(methods.values()))[0].library
    rows: list[dict[str, Any]] = []
    curves: dict[tuple[str, float], list[Curve]] = {}
    runs = [(name, one, v) for name, ones in methods.items() for one in ones for v in config.speeds]
    for method, subject, speed in tqdm(runs, unit="walk", leave=False):
        force = vertical_forces(config, subject, speed)
        rows.append({"method": method, "policy": subject.name, "speed": speed, **profile(force)})
        if force is not None and "failed" not in rows[-1]:
            curves.setdefault((method, speed), []).append(curve(force[:, 0]))
    for speed in config.speeds:
        model = model_profile(nearest_motion(library, speed))
        rows.append({"method": "model", "policy": "", "speed": speed, **model})
    return Report(rows, table(rows), picture(config, curves, library))


def check_straight(subjects: Sequence[Subject]) -> None:
    """Check that policies follow the paper's gaits, straight ahead; modules count as such.

    Raises:
        ConfigurationError: one follows gaits in all directions.
    """
    for subject in subjects:
        if subject.library.command_size > 1:
            raise ConfigurationError(
                f"the benchmark is about the paper's gaits, straight ahead, and {subject.name!r}"
                " follows gaits in all directions; --policy straight is measured by default"
            )


def profile(force: np.ndarray | None) -> dict[str, Any]:
    """Mean `ForceProfile` of both feet from forces (m, 2), or the reason why there is none.

    Args:
        force: vertical forces at 2 kHz [N]; None after a fall.
    """
    if force is None:
        return {"failed": "fell"}
    feet = [force_profile(force[:, i], CASSIE.physics_timestep) for i in range(2)]
    if min(foot.stances for foot in feet) < _LEAST_STANCES:
        return {"failed": "did not step"}
    return asdict(ForceProfile(*np.mean([list(asdict(foot).values()) for foot in feet], axis=0)))


def vertical_forces(config: Config, subject: Subject, speed: float) -> np.ndarray | None:
    """(m, 2) vertical forces at 2 kHz of the settled walk [N]; None after a fall."""
    torch.set_num_threads(1)
    parts = []
    with closing(subject.walking_env(config, 1, num_threads=1)) as env:
        walker = Walker(subject.policy, env, library=subject.library, speed=speed)
        env.base_env.watch(0)
        while walker.time < config.settle + config.walk - CASSIE.policy_period / 2:
            walker.step()
            if walker.fallen:
                return None
            if walker.time > config.settle:
                parts.append(env.base_env.watched[:, VERTICAL].copy())
    assert len(parts[0]) == CASSIE.substeps
    return np.concatenate(parts)


def curve(force: np.ndarray) -> Curve:
    """Mean force of a foot over the stride, from forces (m,) of many strides."""
    starts = stances(force, CASSIE.physics_timestep)[:, 0]
    return Curve(*mean_over_strides(force, starts, _SAMPLES))


def model_force(motion: Motion, samples: int = 4000) -> np.ndarray:
    """(samples,) force of the model's left leg along z over a stride from its touchdown [N]."""
    phase = np.arange(samples) / samples
    if isinstance(motion, Gait):
        time, leg = phase * motion.stride, motion.body.position - motion.feet.position[:, 0]
        axial = np.interp(time, motion.time, motion.leg_force[:, 0])
        force = axial * np.interp(time, motion.time, leg[:, 2] / np.linalg.norm(leg, axis=1))
    else:
        force = motion.sample(phase).ground_force[:, 0, 2]
    return np.roll(force, -round(touchdown_phases(motion)[0] * samples))


def model_profile(gait: Motion) -> dict[str, float]:
    """`ForceProfile` of the model; it has no impact, and its force may be zero in mid-stance."""
    force = model_force(gait)
    period = gait.stride / len(force)
    # a stride begins with the left foot's lift-off
    part = force[: round((1 - touchdown_phases(gait)[0]) * len(force))]
    found = ForceProfile(
        len(humps(part, period)),
        dip_ratio(part, period),
        len(part) * period,
        float(part.sum()) * period,
        float(part.max()),
        1,
    )
    return asdict(found)


def table(rows: list[dict[str, Any]]) -> str:
    """Table of force profiles, a row for each method and speed, means over policies."""
    cells = []
    for method in dict.fromkeys(row["method"] for row in rows):
        for speed in dict.fromkeys(row["speed"] for row in rows):
            found = [r for r in rows if (r["method"], r["speed"]) == (method, speed)]
            stepped = [row for row in found if "failed" not in row]
            if not found:
                continue
            if not stepped:
                cells.append([method, str(round(speed, 3)), found[0]["failed"], *[""] * 5])
                continue
            mean = {k: np.mean([r[k] for r in stepped]) for k in stepped[0] if k in _NUMBERS}
            ratios = [row["dip_ratio"] for row in stepped]
            cells.append(
                [
                    method,
                    str(round(speed, 3)),
                    f"{mean['humps']:.1f}",
                    f"{mean['dip_ratio']:.2f} [{min(ratios):.2f}, {max(ratios):.2f}]",
                    f"{mean['duration']:.3f}",
                    f"{mean['impulse']:.0f}",
                    f"{mean['peak']:.0f}",
                    f"{len(stepped)} of {len(found)}",
                ]
            )
    header = [
        "method", "command [m/s]", "humps", "dip ratio [range]", "stance [s]", "impulse [N s]",
        "peak [N]", "stepped",
    ]  # fmt: skip
    return markdown(header, cells)


_NUMBERS = {"humps", "dip_ratio", "duration", "impulse", "peak"}


def picture(
    config: Config, curves: Mapping[tuple[str, float], Sequence[Curve]], library: GaitLibrary
) -> Figure:
    """Force over the stride: panels for speeds, lines for policies, a band for a single policy."""
    figure = Figure(figsize=(4 * len(config.speeds), 3.6), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(config.speeds), sharey=True))
    share = np.arange(_SAMPLES) / _SAMPLES
    for axis, speed in zip(axes, config.speeds, strict=True):
        model = model_force(nearest_motion(library, speed))
        axis.plot(np.arange(len(model)) / len(model), model, "k--", label="model")
        for k, method in enumerate(dict.fromkeys(method for method, _ in curves)):
            color = SERIES[k % len(SERIES)]
            found = curves.get((method, speed), ())
            for i, one in enumerate(found):
                style: dict[str, Any] = {} if len(found) == 1 else {"lw": 0.8, "alpha": 0.7}
                axis.plot(share, one.mean, color=color, label=None if i else method, **style)
                if len(found) == 1:
                    low, high = one.mean - one.std, one.mean + one.std
                    axis.fill_between(share, low, high, color=color, alpha=0.25, lw=0)
        axis.set(title=f"{round(speed, 3)} m/s", xlabel="stride from touchdown", ylim=(0, None))
        axis.set_xlim(-0.02, 1)  # impacts are at touchdown
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("vertical force of one foot [N]")
    # a method may have fallen at the first speed
    lines, names = zip(*(axis.get_legend_handles_labels() for axis in axes), strict=True)
    named = dict(zip(chain(*names), chain(*lines), strict=True))
    axes[0].legend(named.values(), named, fontsize=8)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
