"""Policies of earlier versions in today's format."""

from __future__ import annotations

import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch
from torchrl.checkpoint import Checkpoint

import aslip
from aslip.errors import FileDamagedError
from aslip.policy import PolicyShape, RunningNormalizer, entry_names, make_actor, read_card
from aslip.transforms import OBSERVATION_TABLE
from benchmarks.faults.strangers import Program
from benchmarks.faults.trainings import Holder
from recipes.convert_policy import Config, main


def _old_file(path: Path, stack: dict[str, Any]) -> dict[str, torch.Tensor]:
    """A policy as earlier versions wrote it; returns its weights."""
    shape = PolicyShape(symmetric=True, hidden=(16,))
    normalizer = RunningNormalizer(64)
    normalizer.update(torch.randn(100, 64))
    actor = make_actor(normalizer, shape)
    weights = dict(actor.state_dict())
    card = {"shape": asdict(shape), "observation": entry_names(OBSERVATION_TABLE), **stack}
    # they stored what follows from the statistics and names, too
    state = {**weights, **dict(actor.named_buffers())}
    checkpoint = Checkpoint(actor=Holder(state))
    checkpoint.save(path, format="archive", metadata={**card, "made_by": {"seed": 3}})
    return weights


@pytest.mark.parametrize(
    ("stack", "name", "baseline"),
    [
        ({}, "paper", "motor_position"),
        ({"stack": "aslip"}, "aslip", "motor_target"),
        ({"stack": None}, None, None),
    ],
)
def test_a_converted_policy_has_the_same_weights(
    tmp_path: Path, stack: dict[str, Any], name: str | None, baseline: str | None
) -> None:
    path = tmp_path / "policy.zip"
    weights = _old_file(path, stack)
    with pytest.raises(FileDamagedError, match=r"no SHA256SUMS.*recipes/convert_policy\.py"):
        aslip.load_policy(path)
    main(Config(path))
    loaded = aslip.load_policy(path).state_dict()
    assert loaded.keys() == weights.keys()
    assert all(torch.equal(loaded[key], weights[key]) for key in weights)
    card = read_card(path)
    assert card["stack"] == name
    assert card["baseline"] == (baseline and f"reference/{baseline}")
    assert card["made_by"] == {"seed": 3}


def test_a_program_in_an_old_policy_is_not_run(tmp_path: Path) -> None:
    path, mark = tmp_path / "policy.zip", tmp_path / "ran"
    _old_file(path, {})
    before = path.read_bytes()
    torch.save(Program(mark), tmp_path / "state.pt")
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(tmp_path / "state.pt", "components/0000-actor/state.pt")
    with pytest.raises(FileDamagedError, match=r"state\.pt.*neither JSON nor an array"):
        main(Config(path))
    assert not mark.exists()
    path.write_bytes(before[:-100])
    with pytest.raises(FileDamagedError, match="no policy of an earlier version"):
        main(Config(path))
