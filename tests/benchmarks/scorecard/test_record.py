"""Records of measured values: kept, compared and refused."""

import json
import math
from pathlib import Path
from shutil import copyfile
from typing import Any

import pytest

from aslip.base.interval import Interval
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.library import GaitLibrary
from aslip.policy import find_policy, read_card
from benchmarks.scorecard.direction_list import TARGETS
from benchmarks.scorecard.record import ValueRecord, describe, policies_text
from benchmarks.scorecard.verdicts import Claim

SHIPPED = Path(__file__).parents[3] / "docs" / "directions.json"
SPEED = Claim("speed", "x", at_most=1.0)


def open_record(path: Path | None, **settings: Any) -> ValueRecord:
    return ValueRecord(path, settings or {"walks": 3}, [SPEED])


def test_values_are_kept_for_each_policy_at_once(tmp_path: Path) -> None:
    """After an interruption, measured policies are not measured again; kinds are kept apart."""
    path, asked = tmp_path / "new" / "record.json", []

    def measure(kind: str, policy: Any) -> dict[str, float | Interval]:
        if policy == "robust" and not asked.count("robust"):
            asked.append(policy)
            raise KeyboardInterrupt
        asked.append(policy)
        return {"speed": Interval(0.5, 0.4, 0.6) if kind == "policy" else math.nan}

    kinds = {"policy": ["straight", "robust"], "paper": ["straight"]}
    with pytest.raises(KeyboardInterrupt):
        open_record(path).measure(kinds, measure)
    record = open_record(path)
    assert record.holds("straight") and not record.holds("robust")
    record.measure(kinds, measure)
    assert asked == ["straight", "robust", "robust", "straight"]
    for found in (record.values(), open_record(path).values()):
        assert found["policy"] == [{"speed": Interval(0.5, 0.4, 0.6)}] * 2
        assert math.isnan(found["paper"][0]["speed"].mean)


def test_without_a_file_values_are_in_memory() -> None:
    record = open_record(None)
    record.measure({"policy": ["straight"]}, lambda *_: {"speed": 1.0})
    assert record.values() == {"policy": [{"speed": Interval(1.0, 1.0, 1.0)}]}


def test_other_weights_under_a_name_are_refused(tmp_path: Path) -> None:
    record = open_record(tmp_path / "record.json")
    record.add("straight", {"speed": 1.0})
    other = tmp_path / "straight" / "policy.zip"
    other.parent.mkdir()
    copyfile(find_policy("robust"), other)
    for policies in ([other], ["robust", tmp_path / "robust.zip"]):
        copyfile(find_policy("straight"), tmp_path / "robust.zip")
        with pytest.raises(ConfigurationError, match=r"several are named '(straight|robust)'"):
            record.check(policies)


def test_records_of_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    open_record(path).add("straight", {"speed": 1.0})
    with pytest.raises(ConfigurationError, match="measured with walks 3, not walks 4"):
        open_record(path, walks=4)
    kept = json.loads(path.read_text())
    kept["policies"][0]["values"]["changes"] = 1.0
    path.write_text(json.dumps(kept))
    with pytest.raises(ConfigurationError, match=r"which measured \['changes'\]; use another file"):
        open_record(path)
    del kept["policies"][0]["sha256"]
    wrong = [{**kept, "settings": [1]}, {"settings": {}, "policies": 3}, [], kept]
    for text in (json.dumps(one) for one in wrong):
        path.write_text(text)
        with pytest.raises(FileDamagedError, match="no record of values"):
            open_record(path)


def test_policies_are_described_by_their_own_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not by `policy.zip`, which the file of every run is called."""
    run = tmp_path / "run"
    run.mkdir()
    for name in ("run/policy.zip", "mine.zip"):
        (tmp_path / name).write_bytes(find_policy("straight").read_bytes())
    monkeypatch.chdir(run)
    given = ("straight", run, run / "policy.zip", "policy.zip", tmp_path / "mine.zip")
    found = [describe(one) for one in given]
    assert [about["name"] for about in found] == ["straight", "run", "run", "run", "mine"]
    assert {about["seed"] for about in found} == {10}
    assert policies_text([{**found[0], "commit": None}]).startswith("`straight` (seed 10, ")
    assert policies_text([]) == "none"


def test_the_shipped_record_holds_the_shipped_policy_on_the_shipped_gaits() -> None:
    """Its trainings differ in their seed only."""
    record = ValueRecord(SHIPPED, {}, TARGETS)
    assert record.holds("directions")
    card, shipped = read_card("directions"), GaitLibrary.load("directions").sha256
    assert card["library_sha256"] == shipped
    # those that the policy follows, or those of its training
    assert record.settings["library_sha256"] in (shipped, card["made_by"].get("trained_on"))
    assert len({one["commit"] for one in record.policies}) == 1
    assert len({one["seed"] for one in record.policies}) == len(record.policies)
    assert all(one.keys() == {claim.name for claim in TARGETS} for one in record.values()["policy"])
