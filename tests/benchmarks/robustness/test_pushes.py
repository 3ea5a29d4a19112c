"""Pushes of walking robots."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.transforms.plan_state import followed
from benchmarks.common import Policies, Subject, table
from benchmarks.robustness import pushes
from benchmarks.robustness.pushes import (
    PUSH_COLUMNS,
    Config,
    main,
    measure_pushes,
    push_rows,
    settle,
)
from tests.benchmarks.robustness import BAR, NO_SWEEPS, SHIPPED


def _config(**settings: Any) -> Config:
    small = {"directions": 2, "phases": 1, "repeats": 1, "bisections": 1, "settle": 0.3}
    small |= {"after": 0.9, "walks": 1, "episode": 1.2, **NO_SWEEPS}
    return Config(**(small | settings))


def test_perturbation_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A robot falls without motor strength or under a push of 240 N s, and otherwise walks."""
    config = _config(
        out=tmp_path, directions=4, bisections=2, largest=480.0, motor_strength=(0.0, 1.0)
    )
    main(config)
    report = json.loads((tmp_path / "pushes.json").read_text())
    assert [row["direction_deg"] for row in report["pushes"]] == [0, 90, 180, 270]
    assert [row["mean"] for row in report["pushes"]] == [0] * 4
    assert report["resolution"] == 120
    assert [(row["value"], row["mean"]) for row in report["sweeps"]] == [(0.0, 0.0), (1.0, 1.0)]
    printed = capsys.readouterr().out
    assert (tmp_path / "pushes.md").read_text() == printed
    (speed,) = report["sweeps"][0]["falls"][0]
    assert f"| motor strength | 0 | 0 [0, 79] | {speed:.2f} |" in printed
    assert "| motor strength | 1 | 100 [21, 100] |  |" in printed
    assert (tmp_path / "pushes.png").read_bytes().startswith(b"\x89PNG")


def test_bisection_converges_from_below() -> None:
    """If every push is survived, on the end of the range."""
    config = _config(bisections=3, largest=1.6, after=0.3)
    survived = measure_pushes(config, SHIPPED, BAR)
    np.testing.assert_allclose(survived, 1.4)
    text = pushes.censored_text(config, survived)
    assert text.startswith(f"{survived.size} of {survived.size} robots survived all pushes, up to")
    assert "`--largest 3.2`" in text
    assert not pushes.censored_text(config, survived - 0.2)


def test_pushed_robots_follow_plans_if_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Any] = []

    def walked(*arguments: Any) -> Any:
        td, there = settle(*arguments)
        found.append(followed(td))
        return td, there

    monkeypatch.setattr(pushes, "settle", walked)
    config = _config(policy=("stones",), settle=0.1, after=0.1, directions=1)
    (subject,) = Policies(config).load()
    for planned in (False, True):
        config = replace(config, planned=planned)
        measure_pushes(config, subject, BAR)
        assert (found[-1] == planned).all()
    with pytest.raises(ConfigurationError, match="has no planner"):
        measure_pushes(config, SHIPPED, BAR)


def _measured(
    monkeypatch: pytest.MonkeyPatch, config: Config, yaw: float, standing: list[bool]
) -> tuple[np.ndarray, list[Any]]:
    """Largest pushes of robots that survive all, and the sequence of calls."""
    done: list[Any] = []
    base = SimpleNamespace(states=lambda: "settled", set_states=done.append)
    env = SimpleNamespace(base_env=base, close=lambda: None)
    turn = [[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]] * len(standing)
    td = {("truth", "pelvis_orientation"): torch.tensor(turn)}

    def survives(*arguments: Any) -> np.ndarray:
        done.append(arguments[-2])
        return np.ones(len(standing), dtype=bool)

    monkeypatch.setattr(Subject, "walking_env", lambda *_: env)
    monkeypatch.setattr(pushes, "settle", lambda *_: (td, np.array(standing)))
    monkeypatch.setattr(pushes, "push_robots", survives)
    return measure_pushes(config, SHIPPED, BAR), done


@pytest.mark.parametrize("yaw", [0.0, 0.4, -2.0])
def test_push_directions_are_relative_to_heading(
    monkeypatch: pytest.MonkeyPatch, yaw: float
) -> None:
    """Forward, left, back and right relative to its yaw, from the same state."""
    config = _config(directions=4, bisections=2, largest=8.0)
    _, done = _measured(monkeypatch, config, yaw, [True] * 4)
    assert done[::2] == ["settled", "settled"]
    for impulses, size in zip(done[1::2], (4.0, 6.0), strict=True):
        ahead = [size * math.cos(yaw), size * math.sin(yaw), 0.0]
        left = [-ahead[1], ahead[0], 0.0]
        expected = [ahead, left, np.negative(ahead), np.negative(left)]
        np.testing.assert_allclose(impulses, expected, atol=1e-5)


def test_a_fall_without_push_gives_zero_impulse(monkeypatch: pytest.MonkeyPatch) -> None:
    config = _config(directions=2, bisections=3, largest=8.0)
    survived, _ = _measured(monkeypatch, config, 0.0, [True, False])
    assert survived.ravel().tolist() == [7.0, 0.0]


def test_pushes_begin_at_their_phase() -> None:
    config = _config(settle=0.51, speed=1.5)
    env = SHIPPED.walking_env(config, 4)
    phase = np.arange(4) / 4
    td, _ = settle(config, env, SHIPPED.policy, phase, BAR)
    difference = np.asarray(td["phase"][:, 0]) - phase
    np.testing.assert_allclose((difference + 0.5) % 1 - 0.5, 0, atol=1e-5)


def _pushes(*impulses: float) -> np.ndarray:
    """One direction and two phases with two repeats each."""
    return np.repeat(np.array(impulses), 2).reshape(1, 2, 2)


def test_pushes_have_mean_and_range_over_phases_and_intervals_over_policies() -> None:
    config = _config(directions=1, phases=2, repeats=2)
    (row,) = push_rows(config, [_pushes(20.0, 40.0)])
    assert (row["mean"], row["low"], row["high"]) == (30.0, 30.0, 30.0)
    assert (
        table(PUSH_COLUMNS, [row]).splitlines()[-1]
        == "| forward | 30.0 | 20.0 at 0 | 40.0 at 0.5 |"
    )
    (row,) = push_rows(config, [_pushes(20.0, 40.0), _pushes(22.0, 42.0)])
    # Student's interval of 30 and 32 N s
    half = 12.706 * math.sqrt(2.0) / math.sqrt(2.0)
    assert (row["mean"], row["low"], row["high"]) == pytest.approx(
        (31.0, 31 - half, 31 + half), 1e-3
    )
