"""Targets of walks in all directions: one table of the other benchmarks' numbers, with verdicts.

    python -m benchmarks.scorecard.direction_targets --policy runs/ppo_directions
    python -m benchmarks.scorecard.direction_targets --policy runs/seed1 runs/seed2 --record s.json

Several policies count as seeds of one method: values are means with 95 % intervals over seeds, and
a target is met if the whole interval meets it. A policy alone has intervals over its commands and
walks. Each policy walks at commands of its own, drawn from
the seed of its training, so that with the default sizes five policies walk at 1000 commands and
through 10 000 changes. Tables and pictures of the benchmarks are written to a folder for each
policy.

With `--record`, the values of each policy are kept in a file. Its policies are not measured again,
and the table is over all of them: after an interruption, the same command continues. `--picture`
draws targets against each other, one point for each policy; the region that meets both is shaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import Directions, check_numbers

_ROBOTS = 50  # whose commands change


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    out: Path = Path("runs/direction_targets")
    """Folder for the table and results."""
    commands: int = 200
    """Number of random commands whose mean velocity is measured."""
    changes: int = 2000
    """Number of sudden changes of the command."""
    placements: int = 40
    """Number of random commands at which the foot placement is measured."""
    stops: int = 12
    """Number of walks that stop, stand and start."""
    pushes: int = 16
    """Directions of pushes, evenly around the robot."""
    walks: int = 16
    """Walks at each value of a parameter of robot or floor."""
    stand: float = 60.0
    """Time of standing [s]."""
    path: float = 300.0
    """Time on the figure of eight [s]."""
    record: Path | None = None
    """File with the values of each policy; its policies count, too."""
    picture: Path | None = None
    """Picture to write."""

    def __post_init__(self) -> None:
        """Check the numbers of footstep commands and changes."""
        super().__post_init__()
        check_numbers(self, placements=1)
        if self.changes > _ROBOTS and self.changes % _ROBOTS:
            raise ConfigurationError(
                f"changes must be at most {_ROBOTS}, or a multiple of it, got {self.changes}"
            )


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final, cast

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.library import GaitLibrary
from aslip.show.palette import SERIES
from aslip.show.plots import save_figure
from aslip.transforms.standing import required_transitions
from benchmarks.common import (
    Policies,
    Policy,
    Report,
    benchmark,
    chosen_library,
    policy_name,
    table,
)
from benchmarks.directions import command_changes, figure_of_eight, stops, tracking
from benchmarks.paper import foot_placement
from benchmarks.robustness import pushes, walking_quality
from benchmarks.robustness.parameters import SWEEPS, Sweeps
from benchmarks.scorecard.direction_list import SWEPT, TARGETS
from benchmarks.scorecard.direction_values import SPEEDS, measure
from benchmarks.scorecard.record import ValueRecord, describe, policies_text
from benchmarks.scorecard.verdicts import Claim, Values, value_text, verdict_rows

_NOT_RECORDED: Final = ("policy", "out", "record", "picture", "library")  # a hash names the library

COLUMNS = {
    "target": "{name}",
    "measured": "{measure}",
    "limit": "{limit}",
    "value": value_text,
    "verdict": "{found[policy][verdict]}",
}

PAIRS: Final = (
    ("velocity, 95 %", "force"),
    ("falls, changes", "pushes, mean"),
    ("feet, straight", "slip"),
    ("power, 2 m/s", "payload"),
)
"""Names of the targets of each panel, along its axes."""

_STOPS: Final = 8  # stops at 1 m/s, each at another phase
_LABEL = 34  # characters in a line of an axis' label
_MARGIN = 0.08  # space around the points, of their range


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each target.

    Raises:
        ConfigurationError: a setting is invalid, two policies have the same name or other gaits,
            the library has no stop and start or none up to 2 m/s, or there is a record and a policy
            or an environment of the caller, which it cannot name.
        FileDamagedError: the file given as record holds no values of policies.
    """
    given = [*config.policy] if policies.given is None else [policies.given]
    settings = {one: benchmarks_of(config, one) for one in given}
    record = open_record(config, library_of_all(config, given))
    make_env = policies.make_env
    record.measure(
        {"policy": given}, lambda _, one: measure(settings[one], one, make_env), make_env
    )
    found = record.values()["policy"]
    rows = verdict_rows(TARGETS, {"policy": found}, {name: walks(config, name) for name in SWEPT})
    parts = [table(COLUMNS, rows, ["---", "---", "---:", "---:", "---"]), falls_text(config, found)]
    if config.record is not None:
        at = ", ".join(sorted({one["measured_at"] or "no commit" for one in record.policies}))
        parts.append(f"Policies: {policies_text(record.policies)}. Measured at {at}.")
    names = [one["name"] for one in record.policies]
    if len(found) > 1:
        parts.append(table_of_each(names, found))
    if config.picture is not None:
        save_figure(picture(names, found), config.picture)
    return Report(rows, "\n\n".join(parts), None, {"policies": names, "rows": rows})


def benchmarks_of(config: Config, policy: Policy) -> dict[str, Any]:
    """Settings of each benchmark for a policy, by its name.

    Raises:
        ConfigurationError: a setting is invalid.
    """
    out = config.out / describe(policy)["name"]
    common: dict[str, Any] = {"out": out, "policy": (policy_name(policy),), "truth": config.truth}
    # benchmarks of straight walks take a module for one that walks straight by default
    library = config.library if isinstance(policy, str | Path) else config.library or "directions"
    common |= {"library": library, "seed": config.seed + (describe(policy)["seed"] or 0)}
    straight = {"speeds": (1.0,) * _STOPS, "walks": _STOPS, "duration": 0.5, "out": out / "stops"}
    return {
        "tracking": tracking.Config(**common, commands=config.commands),
        "changes": command_changes.Config(
            **common, changes=config.changes, robots=min(_ROBOTS, config.changes)
        ),
        "standing": stops.Config(**common, walks=config.stops, duration=config.stand),
        "stops": stops.Config(**{**common, **straight}),
        "path": figure_of_eight.Config(**common, duration=config.path),
        "quality": walking_quality.Config(**common, speeds=SPEEDS),
        "pushes": pushes.Config(**common, walks=config.walks, directions=config.pushes),
        "straight": foot_placement.Config(**common, speeds=SPEEDS),
        "turns": (foot_placement.Config(**common), config.placements),
    }


def library_of_all(config: Config, policies: Sequence[Policy]) -> GaitLibrary:
    """Library of all policies, with checks of what would fail after minutes; see `main`."""
    library, *others = [cast("GaitLibrary", chosen_library(config, one)) for one in policies]
    if {other.sha256 for other in others} - {library.sha256}:
        raise ConfigurationError(f"the policies must follow the same gaits: {[*config.policy]}")
    required_transitions(library)
    for speed in SPEEDS:
        library.check_command((speed, 0.0, 0.0))
    return library


def open_record(config: Config, library: GaitLibrary) -> ValueRecord:
    """Record of values that were measured with given settings; see `ValueRecord`."""
    settings = {k: v for k, v in asdict(config).items() if k not in _NOT_RECORDED}
    settings["library_sha256"] = library.sha256
    return ValueRecord(config.record, settings, TARGETS)


def walks(config: Config, name: str) -> int:
    """Number of walks of a policy that count for the target of a sweep."""
    parameter, low, high = SWEPT[name]
    swept = getattr(Sweeps(), SWEEPS[parameter].flag)
    return config.walks * sum(low <= value <= high for value in swept)


def table_of_each(names: Sequence[str], found: Sequence[Values]) -> str:
    """Table of targets: limit, and value of each policy, "-" where it has none."""
    rows = [
        [claim.name, claim.limit, *(cell(claim, values) for values in found)] for claim in TARGETS
    ]
    return markdown(["target", "limit", *names], rows, ["---", *["---:"] * (1 + len(names))])


def cell(claim: Claim, values: Values) -> str:
    """Value of a target for one policy as text; "-" for none."""
    value = values[claim.name].mean if claim.name in values else math.nan
    return f"{value:.{claim.digits}f}" if math.isfinite(value) else "-"


def falls_text(config: Config, found: Sequence[Mapping[str, Interval]]) -> str:
    """Sentence on the falls that were counted, and how many more are likely."""
    counted = {
        "walks at random commands": ("falls, walks", 1e3, config.commands),
        "sudden changes": ("falls, changes", 1e4, config.changes),
    }
    parts = []
    for what, (name, per, each) in counted.items():
        falls, trials = (
            sum(round(values[name].mean * each / per) for values in found),
            each * len(found),
        )
        most = Interval.of_share(falls, trials).high
        parts.append(f"{falls} in {trials} {what} (at most {per * most:.1f} in {per:g})")
    return f"Falls, with upper 95 % limits: {', '.join(parts)}."


def picture(names: Sequence[str], found: Sequence[Values]) -> Figure:
    """A panel for each pair of targets, with a point for each policy."""
    targets = {claim.name: claim for claim in TARGETS}
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    panels = figure.subplots(2, math.ceil(len(PAIRS) / 2)).flat
    for axes, pair in zip(panels, PAIRS, strict=True):
        x, y = (targets[name] for name in pair)
        for k, (name, values) in enumerate(zip(names, found, strict=True)):
            place = values[x.name].mean, values[y.name].mean
            axes.plot(*place, "o", color=SERIES[k % len(SERIES)], label=name)
        _shade(axes, x, y)
        axes.set_xlabel(textwrap.fill(f"{x.measure}, target {x.limit}", _LABEL))
        axes.set_ylabel(textwrap.fill(f"{y.measure}, target {y.limit}", _LABEL))
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, fontsize=8)
    return figure


def _shade(axes: Axes, x: Claim, y: Claim) -> None:
    """Shade what meets both targets, with the limits inside the panel."""
    for claim, axis in ((x, "x"), (y, "y")):
        limit = _limit(claim)
        low, high = getattr(axes, f"get_{axis}lim")()
        low, high = min(low, limit), max(high, limit)
        space = _MARGIN * (high - low)
        getattr(axes, f"set_{axis}lim")(low - space, high + space)
    met = [
        (limit, high) if math.isfinite(claim.at_least) else (low, limit)
        for claim, limit, (low, high) in (
            (x, _limit(x), axes.get_xlim()),
            (y, _limit(y), axes.get_ylim()),
        )
    ]
    axes.fill_between(met[0], *met[1], color=SERIES[1], alpha=0.15, zorder=0)


def _limit(claim: Claim) -> float:
    return claim.at_least if math.isfinite(claim.at_least) else claim.at_most


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
