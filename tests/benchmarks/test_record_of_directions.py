"""The record of measured targets belongs to the shipped policy, on gaits that its file names."""

from __future__ import annotations

from pathlib import Path

from aslip.library import GaitLibrary
from aslip.policy import read_card
from benchmarks.direction_targets import read_record

RECORD = Path(__file__).parents[2] / "docs" / "directions.json"


def test_the_record_holds_the_shipped_policy_on_its_gaits() -> None:
    """Those that it follows, or those of its training."""
    record, card = read_record(RECORD, {}), read_card("aslip")
    shipped = GaitLibrary.load("directions").sha256
    assert "aslip" in record
    assert card["library_sha256"] == shipped
    assert record.settings["library_sha256"] in (shipped, card["made_by"].get("trained_on"))


def test_the_trainings_of_the_record_differ_in_their_seed_only() -> None:
    policies = read_record(RECORD, {}).policies
    assert len({one["commit"] for one in policies}) == 1
    assert len({one["seed"] for one in policies}) == len(policies)
