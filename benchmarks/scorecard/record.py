"""Record of measured values of policies: one JSON file, over days and machines."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aslip.base.assets import UserPaths
from aslip.base.interval import Interval
from aslip.base.provenance import provenance
from aslip.base.writing import claimed
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import CARD, POLICY_FILE, POLICY_FORMAT, find_policy, read_card
from aslip.training.run import write_text
from benchmarks.common import MakeEnv, Policy, policy_name, without_nan
from benchmarks.scorecard.verdicts import Claim, Values

_KEYS = {"name", "sha256", "seed", "commit", "measured_at", "values"}


@dataclass
class ValueRecord(UserPaths):
    """Measured values of policies, by the hash of their weights.

    Args:
        path: JSON file, which need not exist; None to keep the values in memory only.
        settings: settings of the measurement, as JSON types; if empty, those of the file.
        claims: all claims that values can be of.

    Raises:
        FileDamagedError: the file holds no values of policies.
        ConfigurationError: its policies were measured with other settings, or for other claims.
    """

    path: Path | None
    settings: Mapping[str, Any]
    claims: Sequence[Claim]
    policies: list[dict[str, Any]] = field(init=False, default_factory=list)
    """Name, hash of the weights, seed, commit and policy steps of each policy; its kind, commit of
    the measurement, values, and ends of the intervals over walks where there are any."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read()

    def _read(self) -> None:
        """Read the file, if there is one."""
        if self.path is None or not self.path.is_file():
            return
        try:
            found = json.loads(self.path.read_text(encoding="utf-8"))
            settings, self.policies = found["settings"], [*found["policies"]]
            if not isinstance(settings, dict):
                raise TypeError(f"settings are no object: {settings}")
            if missing := [key for one in self.policies for key in _KEYS - one.keys()]:
                raise KeyError(f"policies without {sorted({*missing})}")
            measured = {name for one in self.policies for name in _values(one)}
            self.settings = self.settings or settings
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileDamagedError(f"{str(self.path)!r} is no record of values: {error}") from error
        if differs := [key for key, value in self.settings.items() if settings.get(key) != value]:
            raise ConfigurationError(
                f"the record {str(self.path)!r} was measured with "
                + ", ".join(f"{key} {settings.get(key)!r}" for key in differs)
                + ", not "
                + ", ".join(f"{key} {self.settings[key]!r}" for key in differs)
                + "; use the same settings, or another file"
            )
        if other := sorted(measured - {claim.name for claim in self.claims}):
            raise ConfigurationError(
                f"the record {str(self.path)!r} is of another version, which measured {other}; use"
                " another file"
            )

    def holds(self, policy: Policy, kind: str = "policy") -> bool:
        """Whether the values of a policy are in the record."""
        digest = _digest(policy)
        return digest is not None and any(
            (one["sha256"], _kind(one)) == (digest, kind) for one in self.policies
        )

    def check(self, policies: Sequence[Policy]) -> None:
        """Check that names tell policies apart, these and those of the record.

        Raises:
            ConfigurationError: two have the same name and other weights; or there is a file, and a
                policy is none.
        """
        names: dict[str, str | None] = {one["name"]: one["sha256"] for one in self.policies}
        for policy in policies:
            name, digest = describe(policy)["name"], _digest(policy)
            if digest is None and self.path is not None:
                raise ConfigurationError(
                    f"the record {str(self.path)!r} holds policies of files; leave out record, or"
                    f" {name}"
                )
            if names.setdefault(name, digest) != digest:
                raise ConfigurationError(
                    f"policies must differ in name, several are named {name!r}; use another record,"
                    " or another name"
                )

    def measure(
        self,
        kinds: Mapping[str, Sequence[Policy]],
        measure: Callable[[str, Policy], Mapping[str, float | Interval]],
        make_env: MakeEnv | None = None,
    ) -> None:
        """Measure the policies that the record lacks, and add the values of each at once.

        Args:
            kinds: kind of policies -> the policies.
            measure: function from kind and policy to values.
            make_env: the caller's function that makes environments, which a file cannot name.

        Raises:
            ConfigurationError: see `check`; or there are a file and `make_env`.
        """
        if self.path is not None and make_env is not None:
            raise ConfigurationError(
                f"the record {str(self.path)!r} holds policies in their own environments; leave out"
                " record, or make_env"
            )
        self.check([policy for of_kind in kinds.values() for policy in of_kind])
        for kind, of_kind in kinds.items():
            for policy in of_kind:
                if not self.holds(policy, kind):
                    self.add(policy, measure(kind, policy), kind)

    def add(
        self, policy: Policy, values: Mapping[str, float | Interval], kind: str = "policy"
    ) -> None:
        """Add the values of a policy in place of older ones of it, and write the file.

        Raises:
            FileDamagedError: the file no longer holds values of policies.
            ConfigurationError: another process has added other weights under the policy's name.
        """
        means = {k: one.mean if isinstance(one, Interval) else one for k, one in values.items()}
        about = {**describe(policy), "sha256": _digest(policy), "kind": kind}
        about |= {"measured_at": provenance()["commit"], "values": without_nan(means)}
        about["intervals"] = {
            name: [one.low, one.high]
            for name, one in values.items()
            if isinstance(one, Interval) and one.low < one.high
        }
        with contextlib.ExitStack() as stack:
            if self.path is not None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                stack.enter_context(claimed(self.path, wait=True))
                self._read()  # another process may have added some since
            self.check([policy])
            same = about["name"], kind
            others = [one for one in self.policies if (one["name"], _kind(one)) != same]
            self.policies = [*others, about]
            if self.path is not None:
                kept = {"settings": dict(self.settings), "policies": self.policies}
                write_text(self.path, json.dumps(kept, indent=1, allow_nan=False) + "\n")

    def values(self) -> dict[str, list[Values]]:
        """Kind of policies -> values of each policy."""
        found: dict[str, list[Values]] = {}
        for one in self.policies:
            found.setdefault(_kind(one), []).append(_values(one))
        return found


def _kind(policy: Mapping[str, Any]) -> str:
    """Kind of a policy of the record."""
    return policy.get("kind", "policy")


def _values(policy: Mapping[str, Any]) -> Values:
    """Values of a policy of the record, with their intervals; NaN where a fall prevented one."""
    return {
        name: Interval(x, *policy.get("intervals", {}).get(name, (x, x)))
        for name, value in policy["values"].items()
        for x in [math.nan if value is None else float(value)]
    }


def describe(policy: Policy) -> dict[str, Any]:
    """Name of a policy without its folder, and seed, commit and policy steps of its training."""
    about: dict[str, Any] = {"seed": None, "commit": None, "steps": None}
    if not isinstance(policy, str | Path):
        return {"name": policy_name(policy), **about}
    made = read_card(policy).get("made_by", {})
    about |= {"commit": made.get("commit"), "steps": made.get("steps")}
    path = Path(policy).resolve()
    path = path.parent if path.name == POLICY_FILE else path
    return {
        "name": path.name.removesuffix(".zip"),
        **about,
        "seed": made.get("settings", {}).get("seed"),
    }


def policies_text(policies: Sequence[Mapping[str, Any]]) -> str:
    """Names, seeds, commits and budgets of policies."""
    texts = []
    for one in policies:
        facts = [f"seed {one['seed']}" if one["seed"] is not None else ""]
        facts += [f"commit {one['commit']}" if one["commit"] else ""]
        facts += [f"{one['steps'] / 1e6:.2f} million policy steps" if one["steps"] else ""]
        known = ", ".join(fact for fact in facts if fact)
        texts.append(f"`{one['name']}`" + (f" ({known})" if known else ""))
    return ", ".join(texts) or "none"


def _digest(policy: Policy) -> str | None:
    """SHA-256 of a policy without its card, which a shipped copy writes anew; None for a module."""
    if not isinstance(policy, str | Path):
        return None
    entries, digest = POLICY_FORMAT.read(find_policy(policy)), hashlib.sha256()
    for name in sorted(entries.keys() - {CARD}):
        digest.update(f"{name} {len(entries[name])} ".encode())
        digest.update(entries[name])
    return digest.hexdigest()
