"""The record of measured targets belongs to the shipped policy and to the shipped gaits."""

from __future__ import annotations

from pathlib import Path

from aslip.library import GaitLibrary
from benchmarks.scorecard.direction_targets import read_record

RECORD = Path(__file__).parents[2] / "docs" / "directions.json"


def test_the_record_holds_the_shipped_policy_on_the_shipped_gaits() -> None:
    record = read_record(RECORD, {})
    assert "aslip" in record
    assert record.settings["library_sha256"] == GaitLibrary.load("directions").sha256


def test_the_trainings_of_the_record_differ_in_their_seed_only() -> None:
    policies = read_record(RECORD, {}).policies
    assert len({one["commit"] for one in policies}) == 1
    assert len({one["seed"] for one in policies}) == len(policies)
