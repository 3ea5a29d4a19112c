"""Targets of walks in all directions against each other, one point for each measured policy.

    python -m benchmarks.scorecard.trades
    python -m benchmarks.scorecard.trades --records docs/directions.json tried.json --picture t.png

A record is a file of `benchmarks.scorecard.direction_targets --record`; all must be measured with
the same settings. The region that meets both targets of a panel is shaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    records: tuple[Path, ...] = (Path("docs/directions.json"),)
    """Records of measured targets."""
    picture: Path | None = None
    """Picture to write."""

    def __post_init__(self) -> None:
        """Check that there is a record."""
        super().__post_init__()
        if not self.records:
            raise ConfigurationError("name at least one record")
        if missing := [str(path) for path in self.records if not path.is_file()]:
            raise ConfigurationError(
                f"there is no record {missing}; make one with python -m"
                " benchmarks.scorecard.direction_targets --record FILE"
            )


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
from collections.abc import Mapping
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aslip.base.tables import markdown
from aslip.show.plots import save_figure
from benchmarks.scorecard.claim_list import Claim
from benchmarks.scorecard.direction_targets import TARGETS, cell, read_record

PAIRS: Final = (
    ("velocity, 95 %", "force"),
    ("falls, changes", "pushes, mean"),
    ("feet, straight", "slip"),
    ("power, 2 m/s", "payload"),
)
"""Names of the targets of each panel, along its axes."""

_MARGIN = 0.08  # space around the points, of their range

Values = Mapping[str, float]
"""Value of each target of a policy; NaN where a fall prevented one."""


def main(config: Config) -> dict[str, Values]:
    """Print a table and draw; returns the values of each policy, by its name."""
    found: dict[str, Values] = {}
    settings: Mapping[str, Any] = {}
    for path in config.records:
        record = read_record(path, settings)
        settings = record.settings
        for about, values in zip(record.policies, record.values(), strict=True):
            name = about["name"]
            if name in found:
                raise ConfigurationError(f"two policies of the records have the name {name!r}")
            found[name] = {target: one.mean for target, one in values.items()}
    print(table(found))
    if config.picture is not None:
        save_figure(picture(found), config.picture)
    return found


def table(found: Mapping[str, Values]) -> str:
    """Values of the targets that are drawn, with their limits."""
    claims = [claim_of(name) for pair in PAIRS for name in pair]
    header = ["policy", *(f"{claim.name} ({claim.limit})" for claim in claims)]
    rows = [
        [name, *(cell(claim, values[claim.name]) for claim in claims)]
        for name, values in found.items()
    ]
    return markdown(header, rows)


def picture(found: Mapping[str, Values]) -> Figure:
    """A panel for each pair of targets, with a point for each policy."""
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    panels = figure.subplots(2, math.ceil(len(PAIRS) / 2)).flat
    for axes, pair in zip(panels, PAIRS, strict=True):
        x, y = (claim_of(name) for name in pair)
        for k, (name, values) in enumerate(found.items()):
            axes.plot(values[x.name], values[y.name], "o", color=f"C{k}", label=name)
        _shade(axes, x, y)
        axes.set_xlabel(f"{x.name} ({x.limit})")
        axes.set_ylabel(f"{y.name} ({y.limit})")
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def claim_of(name: str) -> Claim:
    """Target of a name."""
    return next(claim for claim in TARGETS if claim.name == name)


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
    axes.fill_between(met[0], *met[1], color="C2", alpha=0.15, zorder=0)


def _limit(claim: Claim) -> float:
    return claim.at_least if math.isfinite(claim.at_least) else claim.at_most


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
