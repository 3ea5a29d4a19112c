"""The folder of a run: never overwritten, resumed from the newest intact checkpoint."""

from __future__ import annotations

import json
import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.run import TrainingRun, write_text


@dataclass(frozen=True)
class Settings:
    out: Path
    resume: bool = False
    seed: int = 0
    total_steps: int = 100
    learning_rate: float = 1e-4


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(out=tmp_path / "run")


def _open(settings: Settings, *, resume: bool = False) -> TrainingRun:
    return TrainingRun(settings.out, settings, resume=resume)


def _net(value: float) -> torch.nn.Linear:
    net = torch.nn.Linear(3, 2)
    torch.nn.init.constant_(net.weight, value)
    return net


def _checkpoints(settings: Settings) -> list[Path]:
    return sorted(p for p in (settings.out / "checkpoints").iterdir())


def test_settings_are_kept(settings: Settings) -> None:
    run = _open(settings)
    stored = json.loads((settings.out / "config.json").read_text())
    assert stored == run.settings
    assert stored["learning_rate"] == 1e-4
    assert run.policy_file == settings.out / "policy.zip"


def test_a_folder_with_a_run_is_not_overwritten(settings: Settings) -> None:
    run = _open(settings)
    run.log(1, {"value": 1.0})
    run.save(1, {"step": 1}, counter={"n": 1})
    before = (settings.out / "progress.csv").read_bytes()
    with pytest.raises(ConfigurationError, match=r"holds a run already.*--resume.*--out"):
        _open(settings)
    assert (settings.out / "progress.csv").read_bytes() == before


def test_nothing_cannot_be_resumed(settings: Settings) -> None:
    with pytest.raises(ConfigurationError, match="holds no run to resume"):
        _open(settings, resume=True)
    assert not settings.out.exists()


def test_a_run_without_a_checkpoint_cannot_be_resumed(settings: Settings) -> None:
    _open(settings)
    with pytest.raises(ConfigurationError, match="no checkpoint to resume from"):
        _open(settings, resume=True).restore(net=_net(0.0))


def test_other_settings_cannot_resume(settings: Settings) -> None:
    _open(settings)
    with pytest.raises(ConfigurationError, match=r"seed was 0 and is 4") as info:
        _open(replace(settings, seed=4), resume=True)
    assert "learning_rate" not in str(info.value)
    assert json.loads((settings.out / "config.json").read_text())["seed"] == 0


def test_a_longer_run_in_a_moved_folder_can_resume(settings: Settings) -> None:
    _open(settings)
    moved = replace(settings, out=settings.out.with_name("moved"), resume=True, total_steps=500)
    settings.out.rename(moved.out)
    _open(moved, resume=True)


# -------------------------------------------------------------- checkpoints


def test_the_newest_checkpoint_is_restored(settings: Settings) -> None:
    run = _open(settings)
    for step in (10, 20, 30):
        run.save(step, {"step": step, "elapsed_s": 1.5 * step}, net=_net(step))
    assert len(_checkpoints(settings)) == 2
    net = _net(0.0)
    metadata = _open(settings, resume=True).restore(net=net)
    assert metadata == {"step": 30, "elapsed_s": 45.0}
    assert (net.weight == 30).all()


def _damage(path: Path, how: str) -> None:
    """Make a file unreadable; "weights" leaves all but the last tensor's bytes intact."""
    whole = bytearray(path.read_bytes())
    if how == "weights":
        with zipfile.ZipFile(path) as archive:
            largest = max(archive.infolist(), key=lambda info: info.file_size)
        whole[largest.header_offset + 200] ^= 1
    content = {"truncated": whole[:-200], "empty": b"", "foreign": b"hello", "weights": whole}
    path.write_bytes(content[how])


@pytest.mark.parametrize("how", ["truncated", "empty", "foreign", "weights"])
def test_a_damaged_checkpoint_falls_back_to_the_one_before(settings: Settings, how: str) -> None:
    run = _open(settings)
    for step in (10, 20):
        run.save(step, {"step": step}, net=_net(step))
    _damage(_checkpoints(settings)[-1], how)
    net = _net(0.0)
    assert _open(settings, resume=True).restore(net=net)["step"] == 10
    assert (net.weight == 10).all()


@pytest.mark.parametrize("how", ["truncated", "empty", "foreign", "weights"])
def test_damaged_checkpoints_alone_cannot_be_resumed(settings: Settings, how: str) -> None:
    run = _open(settings)
    for step in (10, 20):
        run.save(step, {"step": step}, net=_net(step))
    for path in _checkpoints(settings):
        _damage(path, how)
    with pytest.raises(ConfigurationError, match="no checkpoint to resume from"):
        _open(settings, resume=True).restore(net=_net(0.0))


def test_a_checkpoint_of_other_parts_is_refused(settings: Settings) -> None:
    """As after a change of the recipe: named, and not half loaded without a word."""
    run = _open(settings)
    run.save(10, {"step": 10}, net=_net(1.0))
    with pytest.raises(ConfigurationError, match="no checkpoint to resume from"):
        _open(settings, resume=True).restore(net=torch.nn.Linear(4, 2))


def test_the_same_step_may_be_saved_again(settings: Settings) -> None:
    run = _open(settings)
    run.save(10, {"step": 10}, net=_net(1.0))
    run.save(10, {"step": 10}, net=_net(2.0))
    net = _net(0.0)
    run.restore(net=net)
    assert (net.weight == 2).all()


# ---------------------------------------------------------------------- csv


def test_the_history_is_what_was_logged(settings: Settings) -> None:
    run = _open(settings)
    assert run.history() == {}
    run.log(10, {"value": 1.25, "other": float("nan")})
    run.log(20, {"value": 1e-9, "other": 3.0})
    history = run.history()
    assert history["step"] == [10, 20]
    assert history["value"] == [1.25, 1e-9]
    assert math.isnan(history["other"][0])
    assert history["other"][1] == 3.0


def test_a_half_written_row_is_ignored(settings: Settings) -> None:
    run = _open(settings)
    run.log(10, {"value": 1.0, "other": 2.0})
    with (settings.out / "progress.csv").open("a") as file:
        file.write("20,3.")
    assert run.history() == {"step": [10], "value": [1.0], "other": [2.0]}


def test_rows_after_the_checkpoint_are_forgotten_on_resume(settings: Settings) -> None:
    """And whole rows follow, also where a row was cut off."""
    run = _open(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": step / 7, "other": float("nan")})
        if step == 20:
            run.save(step, {"step": step}, net=_net(1.0))
    before = run.history()
    with (settings.out / "progress.csv").open("a") as file:
        file.write("40,0.")
    again = _open(settings, resume=True)
    again.restore(net=_net(0.0))
    again.log(30, {"value": 9.0, "other": 1.0})
    history = again.history()
    assert history["step"] == [10, 20, 30]
    assert history["value"] == [*before["value"][:2], 9.0]
    text = (settings.out / "progress.csv").read_text().splitlines()
    assert text[0] == "step,value,other"
    assert len(text) == 4


def test_large_step_counts_survive_a_resume(settings: Settings) -> None:
    run = _open(settings)
    run.log(174_999_040, {"value": 1.0})
    run.save(174_999_040, {"step": 174_999_040}, net=_net(1.0))
    again = _open(settings, resume=True)
    again.restore(net=_net(0.0))
    assert again.history()["step"] == [174_999_040]


def test_a_failed_write_leaves_the_old_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "text"
    write_text(path, "old")

    def fail(*args: object, **kwargs: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="no space"):
        write_text(path, "new")
    assert path.read_text() == "old"
