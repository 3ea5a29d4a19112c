"""Falls in sudden changes of the command."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError
from benchmarks.directions import command_changes
from tests.helpers import limp


def test_a_fall_counts_once_for_the_change_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots fall at chosen steps; commands tell which change is in force."""
    commands = np.arange(12.0).reshape(4, 1, 3).repeat(2, axis=1)
    hold = np.array([[2, 3], [4, 2], [3, 3], [2, 2]])
    falls = {1: [0], 2: [0], 4: [0], 5: [1], 8: [1], 10: [1]}
    seen = []

    def step(policy: object, env: Mock, td: TensorDict) -> TensorDict:
        del policy, env
        seen.append(td["command"][:, 0].tolist())
        fell = torch.tensor([[robot in falls.get(len(seen) - 1, [])] for robot in range(2)])
        return td.clone().update({"next": TensorDict(terminated=fell, batch_size=2)})

    start = TensorDict(command=torch.zeros(2, 3), batch_size=2)
    monkeypatch.setattr(command_changes, "reset_walks", lambda *_: start.clone())
    monkeypatch.setattr(command_changes, "take_step", step)
    monkeypatch.setattr(command_changes, "next_start", lambda td: td.exclude("next"))
    env = Mock(num_envs=2, reset=lambda td: td.exclude("_reset"))
    found = command_changes.walk_changes(Mock(), env, commands, hold)
    # robot 0 falls before the first change and twice after it, robot 1 after the second and third
    # and, uncounted, after its last command
    assert found == [(0, 0), (1, 1), (2, 1)]
    first, second = zip(*seen, strict=True)
    assert first == (0, 0, 3, 3, 3, 3, 6, 6, 6, 9, 9)
    assert second == (0, 0, 0, 3, 3, 6, 6, 6, 9, 9, 9)


def test_falls_are_reported_with_the_commands_around_them(
    gaits: str, tmp_path: Path, written: Callable[[str], Any]
) -> None:
    """Without a policy robots fall about once a second, start again, and fall again."""
    config = command_changes.Config(
        library=gaits, changes=6, robots=3, hold=(0.6, 1.2), out=tmp_path
    )
    (row,) = command_changes.main(config, limp())
    assert row["changes"] == 6
    assert 3 <= len(row["falls"]) <= 6
    assert row["rate"] == pytest.approx(1e4 * len(row["falls"]) / 6)
    for old, new in row["falls"]:
        assert old != new
    written("command_changes")
    with pytest.raises(ConfigurationError, match="robots must be from 1"):
        command_changes.Config(changes=2, robots=3)
