"""Record of measured targets: values of each policy in one JSON file, over days and machines."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aslip.base.assets import UserPaths
from aslip.base.interval import Interval
from aslip.base.provenance import provenance
from aslip.base.writing import claimed
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import CARD, POLICY_FORMAT, find_policy
from aslip.training.run import write_text
from benchmarks.common import without_nan
from benchmarks.scorecard.claims import describe

_KEYS = {"name", "sha256", "seed", "commit", "measured_at", "values"}


@dataclass
class TargetRecord(UserPaths):
    """Measured values of policies, by the hash of their weights.

    Args:
        path: JSON file; need not exist.
        settings: settings of the measurement, as JSON types; if empty, those of the file.

    Raises:
        FileDamagedError: the file is no record.
        ConfigurationError: its policies were measured with other settings.
    """

    path: Path
    settings: Mapping[str, Any]
    policies: list[dict[str, Any]] = field(init=False, default_factory=list)
    """Name, hash of the weights, seed, commit and policy steps of each policy; commit of the
    measurement, values, and ends of the intervals over walks where there are any."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read()

    def _read(self) -> None:
        """Read the file, if there is one."""
        if not self.path.is_file():
            return
        try:
            found = json.loads(self.path.read_text())
            settings, self.policies = found["settings"], [*found["policies"]]
            if not isinstance(settings, dict):
                raise TypeError(f"settings are no object: {settings}")
            if missing := [key for one in self.policies for key in _KEYS - one.keys()]:
                raise KeyError(f"policies without {sorted({*missing})}")
            self.values()
            self.settings = self.settings or settings
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileDamagedError(
                f"{str(self.path)!r} is no record of targets: {error}"
            ) from error
        if differs := [key for key, value in self.settings.items() if settings.get(key) != value]:
            raise ConfigurationError(
                f"the record {str(self.path)!r} was measured with "
                + ", ".join(f"{key} {settings.get(key)!r}" for key in differs)
                + ", not "
                + ", ".join(f"{key} {self.settings[key]!r}" for key in differs)
                + "; use the same settings, or another file"
            )

    def __contains__(self, policy: str | Path) -> bool:
        """Whether the values of a policy are in the record."""
        digest = _digest(policy)
        return any(one["sha256"] == digest for one in self.policies)

    def check(self, policy: str | Path) -> None:
        """Check that the record has no other weights under a policy's name.

        Raises:
            ConfigurationError: it has.
        """
        name, digest = describe(policy)["name"], _digest(policy)
        for one in self.policies:
            if one["name"] == name and one["sha256"] != digest:
                raise ConfigurationError(
                    f"the record {str(self.path)!r} has another policy named {name!r}, trained at"
                    f" commit {one['commit']}; use another record, or another name"
                )

    def add(self, policy: str | Path, values: Mapping[str, Interval]) -> None:
        """Add the values of a policy in place of older ones of it, and write the file.

        Raises:
            FileDamagedError: the file is no record any more.
            ConfigurationError: another process has added other weights under the policy's name.
        """
        about = {**describe(policy), "sha256": _digest(policy)}
        means = {name: one.mean for name, one in values.items()}
        about |= {"measured_at": provenance()["commit"], "values": without_nan(means)}
        about["intervals"] = {
            name: [one.low, one.high] for name, one in values.items() if one.low < one.high
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with claimed(self.path, wait=True):
            self._read()  # another process may have added some since
            self.check(policy)
            others = [one for one in self.policies if one["sha256"] != about["sha256"]]
            self.policies = [*others, about]
            kept = {"settings": dict(self.settings), "policies": self.policies}
            write_text(self.path, json.dumps(kept, indent=1, allow_nan=False) + "\n")

    def values(self) -> list[dict[str, Interval]]:
        """Values of each policy, with their intervals; NaN where a fall prevented one."""
        return [
            {
                name: Interval(x, *one.get("intervals", {}).get(name, (x, x)))
                for name, value in one["values"].items()
                for x in [math.nan if value is None else float(value)]
            }
            for one in self.policies
        ]


def _digest(policy: str | Path) -> str:
    """SHA-256 of a policy without its card, which a shipped copy writes anew."""
    entries, digest = POLICY_FORMAT.read(find_policy(policy)), hashlib.sha256()
    for name in sorted(entries.keys() - {CARD}):
        digest.update(f"{name} {len(entries[name])} ".encode())
        digest.update(entries[name])
    return digest.hexdigest()
