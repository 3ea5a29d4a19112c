"""Folder of a run: never overwritten, resumed from the newest intact checkpoint."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.training import run as run_module
from aslip.training.provenance import peak_memory
from aslip.training.run import TrainingRun, TrainingStoppedError, write_text
from benchmarks.common import quiet


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


def _save(run: TrainingRun, *steps: int) -> None:
    """Save checkpoints of a network whose weights equal the step."""
    for step in steps:
        with run.saving({"net": _net(step)}, 0.0) as keep:
            keep(step, {"elapsed_s": 1.5 * step})


def _checkpoints(settings: Settings) -> list[Path]:
    return sorted((settings.out / "checkpoints").iterdir())


def _steps(settings: Settings) -> list[int]:
    """Policy steps of the existing checkpoints."""
    return [int(path.stem.rpartition("-")[2]) for path in _checkpoints(settings)]


def _fail(*args: object, **kwargs: object) -> None:
    raise OSError(28, "No space left on device")


def test_settings_are_kept(settings: Settings) -> None:
    run = _open(settings)
    stored = json.loads((settings.out / "config.json").read_text())
    assert stored == run.settings
    assert stored["learning_rate"] == 1e-4
    assert run.policy_file == settings.out / "policy.zip"


def test_a_folder_with_a_run_is_not_overwritten(settings: Settings) -> None:
    run = _open(settings)
    run.log(1, {"value": 1.0})
    _save(run, 1)
    before = (settings.out / "progress.csv").read_bytes()
    with pytest.raises(ConfigurationError, match=r"holds a run already.*--resume.*--out"):
        _open(settings)
    assert (settings.out / "progress.csv").read_bytes() == before


@pytest.mark.parametrize("name", ["progress.csv", "policy.zip", "config.json"])
def test_remains_of_a_run_are_not_overwritten(settings: Settings, name: str) -> None:
    """A learning curve, a policy, or settings of another program."""
    settings.out.mkdir()
    (settings.out / name).write_text('{"other": "thing"}')
    with pytest.raises(ConfigurationError, match="holds a run already"):
        _open(settings)
    assert [file.name for file in settings.out.iterdir()] == [name]
    assert (settings.out / name).read_text() == '{"other": "thing"}'


def test_a_run_without_a_checkpoint_may_be_overwritten(settings: Settings) -> None:
    _open(settings)
    _open(settings)


def test_an_empty_folder_cannot_be_resumed(settings: Settings) -> None:
    with pytest.raises(ConfigurationError, match="holds no run to resume"):
        _open(settings, resume=True)
    assert not settings.out.exists()


def test_a_resumed_run_without_a_checkpoint_starts_from_the_beginning(settings: Settings) -> None:
    run = _open(settings)
    run.log(10, {"value": 1.0})
    with quiet() as said:
        again = _open(settings, resume=True)
        assert again.restore({"net": _net(0.0)}) is None
    assert "starts from the beginning" in said[0]
    assert again.history() == {}
    again.log(10, {"value": 2.0})
    assert again.history() == {"step": [10], "value": [2.0]}


def test_damaged_settings_are_named(settings: Settings) -> None:
    _open(settings)
    for text in ("", '{"seed": 0', "3"):
        (settings.out / "config.json").write_text(text)
        with pytest.raises(FileDamagedError, match=r"config\.json"):
            _open(settings, resume=True)


@pytest.mark.parametrize("resume", [False, True])
def test_an_unwritable_folder_is_refused_at_once(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, resume: bool
) -> None:
    _open(settings)

    def deny(*args: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(run_module, "write_text", deny)
    with pytest.raises(ConfigurationError, match=r"run' cannot be written to.*denied.*--out"):
        _open(settings, resume=resume)


def test_a_file_instead_of_a_folder_is_refused(settings: Settings) -> None:
    settings.out.write_text("mine")
    with pytest.raises(ConfigurationError, match="cannot be written to"):
        _open(settings)
    assert settings.out.read_text() == "mine"


def test_a_run_cannot_resume_with_other_settings(settings: Settings) -> None:
    _open(settings)
    with pytest.raises(ConfigurationError, match=r"seed was 0 and is 4") as info:
        _open(replace(settings, seed=4), resume=True)
    assert "learning_rate" not in str(info.value)
    assert json.loads((settings.out / "config.json").read_text())["seed"] == 0


def test_a_moved_run_can_resume_with_more_steps(settings: Settings) -> None:
    _open(settings)
    moved = replace(settings, out=settings.out.with_name("moved"), resume=True, total_steps=500)
    settings.out.rename(moved.out)
    assert _open(moved, resume=True).changes == ["total_steps 100 -> 500"]
    assert _open(moved, resume=True).changes == []


def test_an_error_lists_some_differences_and_a_remedy(settings: Settings) -> None:
    """Long texts are shown from their first difference on."""
    texts = {f"part {i}": f"{'same ' * 30}{i} here {'and so on ' * 30}" for i in range(9)}
    TrainingRun(settings.out, settings, resume=False, transforms=texts)
    others = {name: text.replace("here", "there") for name, text in texts.items()}
    with pytest.raises(ConfigurationError) as info:
        TrainingRun(settings.out, settings, resume=True, transforms=others)
    message = str(info.value)
    assert "part 0 was ..." in message
    assert "same 0 here and so on" in message
    assert "same 0 there and so on" in message
    assert "part 4" not in message
    assert "and 5 more; resume it with its own settings, or start another run" in message
    assert len(message) < 1000


# -------------------------------------------------------------- checkpoints


def test_the_newest_checkpoint_is_restored(settings: Settings) -> None:
    _save(_open(settings), 10, 20, 30)
    net = _net(0.0)
    metadata = _open(settings, resume=True).restore({"net": net})
    assert metadata == {"step": 30, "elapsed_s": 45.0}
    assert (net.weight == 30).all()


def test_the_last_three_checkpoints_are_kept(settings: Settings) -> None:
    run = _open(settings)
    _save(run, 10, 20, 30)
    assert _steps(settings) == [10, 20, 30]
    _save(run, 40, 50)
    assert _steps(settings) == [30, 40, 50]


def test_checkpoints_are_written_at_the_given_interval(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first is written at once, the last at the end."""
    now, run = [1000.0], _open(settings)
    monkeypatch.setattr(run_module.time, "monotonic", lambda: now[0])
    found = []
    with run.saving({"net": _net(0.0)}, 2.0) as keep:
        for step in range(1, 7):
            keep(step, {})
            found.append(_steps(settings))
            now[0] += 50.0
    assert found == [[1], [1], [1], [1, 4], [1, 4], [1, 4]]
    assert _steps(settings) == [1, 4, 6]


def test_the_last_copy_is_saved_however_the_training_ends(settings: Settings) -> None:
    """The copy after the last update is saved, not the state during an update."""
    endings = {
        10: (KeyboardInterrupt, KeyboardInterrupt),
        20: (ValueError, TrainingStoppedError),
        30: (SystemExit, SystemExit),
    }
    run = _open(settings)
    for step, (raised, seen) in endings.items():
        net = _net(step)
        with quiet(), pytest.raises(seen), run.saving({"net": net}, 1e9) as keep:
            for before in (step - 2, step - 1, step):
                keep(before, {})
            torch.nn.init.constant_(net.weight, -1.0)
            raise raised
        restored = _net(0.0)
        kept = _open(settings, resume=True).restore({"net": restored})
        assert kept == {"step": step}
        assert (restored.weight == step).all()


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_training_says_what_is_saved_and_how_to_resume(
    settings: Settings, capsys: pytest.CaptureFixture[str], kind: type[BaseException]
) -> None:
    """Before writing, which may take a while, it says that it stops."""
    run = TrainingRun(settings.out, settings, resume=False, go_on="python mine.py --resume")
    with pytest.raises(kind), run.saving({"net": _net(1.0)}, 1e9) as keep:
        keep(10, {})
        keep(20, {})
        raise kind
    said = capsys.readouterr().err.split("\n")
    assert said[1] == f"stopping: saving the run in '{settings.out}'"
    assert said[3].startswith("interrupted after 20 policy steps; saved in ")
    assert said[3].endswith("checkpoint-000000000020.zip'")
    assert said[4] == "to continue: python mine.py --resume"
    assert _steps(settings) == [10, 20]


def test_an_interrupted_training_says_that_there_is_nothing_to_save(
    settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _open(settings)
    with pytest.raises(KeyboardInterrupt), run.saving({"net": _net(1.0)}, 0.0):
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert "before the first update" in said
    assert "to continue: resume=True" in said


def test_an_interrupted_training_says_what_could_not_be_saved(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _open(settings)
    _save(run, 10)
    monkeypatch.setattr(run_module, "save_checkpoint", _fail)
    with pytest.raises(KeyboardInterrupt), run.saving({"net": _net(5.0)}, 1e9) as keep:
        keep(20, {})
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert "the checkpoint of 20 policy steps could not be written" in said
    assert "continues from the checkpoint of 10 steps" in said


def test_an_error_names_its_cause_and_the_checkpoint_to_resume_from(settings: Settings) -> None:
    run = _open(settings)
    with (
        pytest.raises(TrainingStoppedError) as info,
        quiet() as said,
        run.saving({"net": _net(1.0)}, 0.0) as keep,
    ):
        keep(10, {})
        raise ValueError("the robot has left")
    assert "10 policy steps by ValueError: the robot has left" in str(info.value)
    assert "--resume continues from the checkpoint of 10 steps" in str(info.value)
    assert isinstance(info.value.__cause__, ValueError)
    assert said == ["training stopped"]


def test_an_error_before_the_first_update_leaves_no_checkpoint(settings: Settings) -> None:
    run = _open(settings)
    stopped = pytest.raises(TrainingStoppedError, match="continues from no checkpoint")
    with quiet(), stopped, run.saving({"net": _net(1.0)}, 0.0):
        raise ValueError("at once")
    assert _checkpoints(settings) == []


def test_sigterm_saves_and_exits(settings: Settings) -> None:
    before = signal.getsignal(signal.SIGTERM)
    run = _open(settings)
    with pytest.raises(SystemExit) as info, run.saving({"net": _net(1.0)}, 1e9) as keep:
        for step in (10, 20):
            keep(step, {})
        os.kill(os.getpid(), signal.SIGTERM)
        pytest.fail("not reached")
    assert info.value.code == 128 + signal.SIGTERM
    assert _steps(settings) == [10, 20]
    assert signal.getsignal(signal.SIGTERM) is before


def _damage(path: Path, how: str) -> None:
    """Make a file unreadable; "weights" leaves all but one byte of its largest part intact."""
    whole = bytearray(path.read_bytes())
    if how == "weights":
        with zipfile.ZipFile(path) as archive:
            largest = max(archive.infolist(), key=lambda info: info.file_size)
        whole[largest.header_offset + 200] ^= 1
    content = {"truncated": whole[:-200], "empty": b"", "foreign": b"hello", "weights": whole}
    path.write_bytes(content[how])


DAMAGES = ["truncated", "empty", "foreign", "weights"]


@pytest.mark.parametrize("how", DAMAGES)
def test_a_damaged_newest_checkpoint_falls_back_to_the_previous_one(
    settings: Settings, how: str
) -> None:
    """A message says so, and the damaged file is renamed, so that it cannot block new ones."""
    _save(_open(settings), 10, 20)
    newest = _checkpoints(settings)[-1]
    _damage(newest, how)
    net, run = _net(0.0), _open(settings, resume=True)
    with quiet() as said:
        kept = run.restore({"net": net})
    assert kept == {"step": 10, "elapsed_s": 15.0}
    assert (net.weight == 10).all()
    assert any(
        str(newest) in line and "falling back to the previous checkpoint" in line for line in said
    )
    assert [path.name for path in _checkpoints(settings)] == [
        "checkpoint-000000000010.zip",
        "checkpoint-000000000020.zip.damaged",
    ]
    _save(run, 15)
    with quiet() as said:
        assert _open(settings, resume=True).restore({"net": net}) == {"step": 15, "elapsed_s": 22.5}
    assert said == []


@pytest.mark.parametrize("how", DAMAGES)
def test_a_run_with_only_damaged_checkpoints_cannot_resume(settings: Settings, how: str) -> None:
    """The error names all, and none is changed: another version may be able to read them."""
    _save(_open(settings), 10, 20)
    paths = _checkpoints(settings)
    for path in paths:
        _damage(path, how)
    with quiet(), pytest.raises(FileDamagedError, match="no checkpoint to resume from") as info:
        _open(settings, resume=True).restore({"net": _net(0.0)})
    assert all(path.name in str(info.value) for path in paths)
    assert _checkpoints(settings) == paths


def test_a_checkpoint_with_other_components_is_refused(settings: Settings) -> None:
    """A checkpoint of a changed recipe names the missing components, and nothing is loaded."""
    _save(_open(settings), 10)
    others = ({"net": torch.nn.Linear(4, 2)}, {"net": _net(0.0), "other": _net(0.0)})
    for components, word in zip(others, ("size mismatch", "lacks.*other"), strict=True):
        with quiet(), pytest.raises(FileDamagedError, match=word):
            _open(settings, resume=True).restore(components)


def test_a_resumed_run_that_stops_at_once_saves_nothing(settings: Settings) -> None:
    _save(_open(settings), 10)
    before = _checkpoints(settings)[0].stat().st_mtime_ns
    run = _open(settings, resume=True)
    components = {"net": _net(0.0)}
    run.restore(components)
    with run.saving(components, 0.0):
        pass
    assert _checkpoints(settings)[0].stat().st_mtime_ns == before


def test_the_same_checkpoint_is_written_only_once(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, save = [], run_module.save_checkpoint
    monkeypatch.setattr(
        run_module, "save_checkpoint", lambda path, *a: (written.append(path), save(path, *a))
    )
    _save(_open(settings), 10, 20)
    assert written == _checkpoints(settings)


def test_temporary_files_of_a_killed_process_are_removed(settings: Settings) -> None:
    _save(_open(settings), 10)
    folder = settings.out / "checkpoints"
    (folder / ".checkpoint-000000000020.zip.stage-1" / "components").mkdir(parents=True)
    (folder / ".checkpoint-000000000020.zip.part").write_bytes(b"half")
    _open(settings, resume=True)
    assert _steps(settings) == [10]


# --------------------------------------------------------------------- full disk


def test_training_continues_on_a_full_disk(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Existing checkpoints stay; the next checkpoint is another attempt."""
    run = _open(settings)
    _save(run, 10)
    before = _checkpoints(settings)[0].read_bytes()
    with quiet() as said, run.saving({"net": _net(5.0)}, 0.0) as keep:
        with monkeypatch.context() as patch:
            patch.setattr(run_module, "save_checkpoint", _fail)
            keep(20, {})
        assert _steps(settings) == [10]
        assert _checkpoints(settings)[0].read_bytes() == before
        keep(30, {})
    assert ["20 policy steps could not be written" in line for line in said] == [True]
    assert "No space left on device" in said[0]
    assert _steps(settings) == [10, 30]


def test_a_last_checkpoint_that_cannot_be_written_is_an_error(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _open(settings)
    _save(run, 10)
    monkeypatch.setattr(run_module, "save_checkpoint", _fail)
    stopped = pytest.raises(TrainingStoppedError)
    with quiet(), stopped as info, run.saving({"net": _net(5.0)}, 0.0) as keep:
        keep(20, {})
    assert "the checkpoint of 20 policy steps could not be written" in str(info.value)
    assert "continues from the checkpoint of 10 steps" in str(info.value)


def test_a_partly_written_checkpoint_is_removed(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full after some of the archive's entries."""
    run = _open(settings)
    _save(run, 10)
    write, left = zipfile.ZipFile.writestr, [2]

    def fill(self: zipfile.ZipFile, *args: Any, **kwargs: Any) -> None:
        left[0] -= 1
        _fail() if left[0] < 0 else write(self, *args, **kwargs)

    monkeypatch.setattr(zipfile.ZipFile, "writestr", fill)
    with quiet(), pytest.raises(TrainingStoppedError):
        _save(run, 20)
    assert [path.name for path in _checkpoints(settings)] == ["checkpoint-000000000010.zip"]


def test_rows_wait_for_space_on_the_disk(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No checkpoint is written before the rows up to it."""
    run = _open(settings)
    run.log(10, {"value": 1.0})
    with quiet() as said, monkeypatch.context() as patch:
        patch.setattr(Path, "open", _fail)
        run.log(20, {"value": 2.0})
        run.log(30, {"value": 3.0})
        with pytest.raises(TrainingStoppedError):
            _save(run, 30)
    assert ["could not be written" in line for line in said] == [True, True, True]
    assert _steps(settings) == []
    assert run.history()["step"] == [10]
    _save(run, 30)
    assert run.history() == {"step": [10, 20, 30], "value": [1.0, 2.0, 3.0]}
    run.log(40, {"value": 4.0})
    assert run.history()["step"] == [10, 20, 30, 40]


def test_a_partly_written_row_is_removed(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _open(settings)
    run.log(10, {"value": 1.0})
    before = (settings.out / "progress.csv").read_bytes()
    run.close()  # TensorBoard writes in a thread, to which the limit must not apply
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with quiet() as said:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 3, limits[1]))
        try:
            run.log(20, {"value": 2.0})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "could not be written" in said[0]
    assert (settings.out / "progress.csv").read_bytes() == before
    run.log(30, {"value": 3.0})
    assert run.history()["step"] == [10, 20, 30]


# ---------------------------------------------------------------------- csv


def test_the_history_equals_the_logged_rows(settings: Settings) -> None:
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
    with (settings.out / "progress.csv").open("a") as file:
        file.write(",na")
    assert run.history() == {"step": [10], "value": [1.0], "other": [2.0]}


def test_a_damaged_row_is_named_and_does_not_prevent_resuming(settings: Settings) -> None:
    run = _open(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": 1.0})
    _save(run, 30)
    file = settings.out / "progress.csv"
    file.write_bytes(file.read_bytes().replace(b"20,1", b"\xff0,1"))
    with pytest.raises(FileDamagedError, match=r"line 3 of .*progress\.csv"):
        run.history()
    again = _open(settings, resume=True)
    kept = again.restore({"net": _net(0.0)})
    assert kept is not None
    assert kept["step"] == 30
    assert again.history() == {"step": [10, 30], "value": [1.0, 1.0]}


def test_rows_after_the_checkpoint_are_dropped_on_resume(settings: Settings) -> None:
    """New rows are complete, even if the last one was cut off."""
    run = _open(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": step / 7, "other": float("nan")})
        if step == 20:
            _save(run, step)
    before = run.history()
    with (settings.out / "progress.csv").open("a") as file:
        file.write("4")
    text = (settings.out / "progress.csv").read_text().splitlines()
    again = _open(settings, resume=True)
    again.restore({"net": _net(0.0)})
    again.log(30, {"value": 9.0, "other": 1.0})
    history = again.history()
    assert history["step"] == [10, 20, 30]
    assert history["value"] == [*before["value"][:2], 9.0]
    after = (settings.out / "progress.csv").read_text().splitlines()
    assert after == [*text[:3], "30,9,1"]


def test_tensorboard_points_after_the_checkpoint_are_dropped_on_resume(settings: Settings) -> None:
    """TensorBoard drops them, as the event file records the resumed step."""
    run = _open(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": float(step)})
        if step == 20:
            _save(run, step)
    run.close()
    again = _open(settings, resume=True)
    again.restore({"net": _net(0.0)})
    for step in (30, 40):
        again.log(step, {"value": step + 0.5})
    again.close()
    events = EventAccumulator(str(settings.out / "tensorboard")).Reload().Scalars("value")
    assert [(e.step, e.value) for e in events] == [(10, 10), (20, 20), (30, 30.5), (40, 40.5)]


def test_large_step_counts_survive_a_resume(settings: Settings) -> None:
    run = _open(settings)
    run.log(174_999_040, {"value": 1.0})
    _save(run, 174_999_040)
    again = _open(settings, resume=True)
    again.restore({"net": _net(0.0)})
    assert again.history()["step"] == [174_999_040]


def test_peak_memory_is_that_of_this_process_alone() -> None:
    """On Linux, getrusage includes the peak of the parent process."""
    burden = bytearray(2**30)
    code = (
        "from aslip.training.provenance import peak_memory\n"
        "block = bytearray(2**27); print(peak_memory())"
    )
    command = [sys.executable, "-c", code]
    shown = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    assert peak_memory() > len(burden) / 2**30
    assert 0.125 < float(shown) < 1.0


def test_a_failed_write_keeps_the_old_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "text"
    write_text(path, "old")

    def fail(*args: object, **kwargs: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="no space"):
        write_text(path, "new")
    assert path.read_text() == "old"
