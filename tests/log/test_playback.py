"""Replays are bit-equal, or name the reason for a difference."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.log import Recording, replay
from aslip.log.__main__ import main
from aslip.sim import PD
from tests.log.helpers import with_column


def test_replay_from_any_state_is_bit_equal(recording: Recording) -> None:
    """From each of the log's states, through pushes, falls and resets."""
    states = recording["/state"]
    assert len(states) > 4
    for time in states.time[states.time < recording["/step"].time[-1]]:
        result = replay(recording, float(time))
        assert result.equal
        assert result.doubts == ()
        assert result.start == pytest.approx(time)
        assert result.compared >= 1
        assert result.steps > 0
    assert replay(recording).steps == 100


def _changed(
    recording: Recording, topic: str, name: str, row: int | tuple[int, int], by: float
) -> Recording:
    column = recording[topic][name].copy()
    column[row] += by
    return with_column(recording, topic, name, column)


def test_replay_detects_a_changed_motor_target_and_goes_on(recording: Recording) -> None:
    """To the end, where episodes begin from the log's own states."""
    row = int(np.searchsorted(recording["/step"].time, 1.0))
    other = _changed(recording, "/step", "motor_target_left_knee", row, 1e-9)
    result = replay(other)
    assert not result.equal
    assert result.diverged_at is not None
    assert result.diverged_at >= 1.0
    assert result.largest_difference > 0
    assert (result.steps, result.compared) == (100, replay(recording).compared)


def test_replay_detects_a_changed_push(recording: Recording) -> None:
    assert not replay(_changed(recording, "/step", "push_y", 3, 1e-6)).equal


def test_replay_detects_one_changed_bit_of_a_state(recording: Recording) -> None:
    states = recording["/state"]
    integration = states["integration"].copy()
    # what comes after the last step is where an episode would begin
    last = np.searchsorted(states.time, recording["/step"].time[-1], side="right") - 1
    integration[last, 5] = np.nextafter(integration[last, 5], np.inf)
    result = replay(with_column(recording, "/state", "integration", integration))
    assert result.diverged_at == pytest.approx(states.time[last])


def test_reasons_for_a_difference_are_named(recording: Recording) -> None:
    others = dict.fromkeys(("version/mujoco", "model_digest", "low_level_digest"), "3.99.0")
    changed = replace(recording, metadata={**recording.metadata, **others})
    result = replay(changed, float(recording["/state"].time[-3]))
    assert result.equal
    assert [text.split(", and")[0] for text in result.doubts] == [
        f"{name} is 3.99.0 in the log" for name in others
    ]


def test_log_without_states_is_reported(recording: Recording) -> None:
    series = {topic: s for topic, s in recording.series.items() if topic != "/state"}
    with pytest.raises(UnknownNameError, match=r"cannot replay .* no topic '/state'"):
        replay(replace(recording, series=series))
    with pytest.raises(ConfigurationError, match="no state at -1"):
        replay(recording, -1.0)
    with pytest.raises(ConfigurationError, match="no policy step follows the state at"):
        replay(recording, 100.0)


def test_replay_resumes_after_a_gap(recording: Recording) -> None:
    """Replay continues from the first state after the gap of a recovered log."""
    step = recording["/step"]
    kept = (step.time < 0.6) | (step.time > 0.7)
    columns = {name: column[kept] for name, column in step.columns.items()}
    gap = replace(step, time=step.time[kept], columns=columns)
    result = replay(replace(recording, series={**recording.series, "/step": gap}))
    assert result.equal
    assert result.steps < 100 - (~kept).sum() + 1
    assert result.compared >= 2


# ----------------------------------------------------------------- from a shell


def test_commands_report_a_complete_log(
    walk: tuple[Path, list], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(walk[0])
    assert main(["info", log]) == 0
    output = capsys.readouterr().out
    assert "/joint_states" in output
    assert "model.xml" in output
    assert "term_com_vel" in output  # columns by name
    assert main(["check", log]) == 0
    assert "complete and intact" in capsys.readouterr().out
    assert main(["replay", "--verify", log]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("from 0.00 s: 100 policy steps")
    assert all(line.endswith("all bit-equal") for line in lines)
    assert not lines[1].startswith("from 0.00 s")


def test_commands_fail_on_a_damaged_log(
    walk: tuple[Path, list], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "walk.mcap.part"
    cut.write_bytes(walk[0].read_bytes()[:-1000])
    for command in ("check", "replay"):
        assert main([command, str(cut)]) == 2
        error = capsys.readouterr().err
        assert "unfinished" in error
        assert f"python -m aslip.log recover {cut}" in error
    kept = cut.read_bytes()
    assert main(["recover", str(cut), "--out", str(tmp_path / "walk.mcap")]) == 0
    assert "walk.mcap: " in capsys.readouterr().out
    assert main(["check", str(tmp_path / "walk.mcap")]) == 0
    assert cut.read_bytes() == kept
    assert sorted(file.name for file in tmp_path.iterdir()) == ["walk.mcap", "walk.mcap.part"]


def test_verification_fails_when_the_simulation_differs(
    walk: tuple[Path, list], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Changed code of the drive is named as the reason."""
    torque = PD.torque

    def stronger(drive: PD, *args: np.ndarray, out: np.ndarray) -> np.ndarray:
        torque(drive, *args, out=out)
        out *= 1.01
        return out

    monkeypatch.setattr(PD, "torque", stronger)
    monkeypatch.setattr("aslip.log.playback.low_level_digest", lambda: "other")
    assert main(["replay", "--verify", str(walk[0])]) == 1
    output = capsys.readouterr().out
    assert "differs from" in output
    assert "low_level_digest is" in output
