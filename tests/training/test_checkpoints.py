"""Checkpoints of a run: rotation, interruption, and resuming from the newest intact one."""

from __future__ import annotations

import os
import signal
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch

from aslip.base.processes import ENDINGS
from aslip.errors import FileDamagedError
from aslip.training import run as run_module
from aslip.training.run import TrainingRun, TrainingStoppedError
from tests.training.run_folder import (
    Settings,
    checkpoints,
    constant_network,
    fail_on_full_disk,
    open_run,
    save_steps,
    saved_steps,
)
from tests.training.trainings import quiet


def test_the_newest_checkpoint_is_restored(settings: Settings) -> None:
    save_steps(open_run(settings), 10, 20, 30)
    net = constant_network(0.0)
    metadata = open_run(settings, resume=True).restore({"net": net})
    assert metadata == {"step": 30, "elapsed_s": 45.0}
    assert (net.weight == 30).all()


def test_the_last_three_checkpoints_are_kept(settings: Settings) -> None:
    run = open_run(settings)
    save_steps(run, 10, 20, 30)
    assert saved_steps(settings) == [10, 20, 30]
    save_steps(run, 40, 50)
    assert saved_steps(settings) == [30, 40, 50]


def test_checkpoints_are_written_at_the_given_interval(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first is written at once, the last at the end."""
    now, run = [1000.0], open_run(settings)
    monkeypatch.setattr(run_module.time, "monotonic", lambda: now[0])
    found = []
    with run.saving({"net": constant_network(0.0)}, 2.0) as keep:
        for step in range(1, 7):
            keep(step, {})
            found.append(saved_steps(settings))
            now[0] += 50.0
    assert found == [[1], [1], [1], [1, 4], [1, 4], [1, 4]]
    assert saved_steps(settings) == [1, 4, 6]


def test_the_last_copy_is_saved_however_the_training_ends(settings: Settings) -> None:
    """The copy after the last update is saved, not the state during an update."""
    endings = {
        10: (KeyboardInterrupt, KeyboardInterrupt),
        20: (ValueError, TrainingStoppedError),
        30: (SystemExit, SystemExit),
    }
    run = open_run(settings)
    for step, (raised, seen) in endings.items():
        net = constant_network(step)
        with quiet(), pytest.raises(seen), run.saving({"net": net}, 1e9) as keep:
            for before in (step - 2, step - 1, step):
                keep(before, {})
            torch.nn.init.constant_(net.weight, -1.0)
            raise raised
        restored = constant_network(0.0)
        kept = open_run(settings, resume=True).restore({"net": restored})
        assert kept == {"step": step}
        assert (restored.weight == step).all()


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_training_says_what_is_saved_and_how_to_resume(
    settings: Settings, capsys: pytest.CaptureFixture[str], kind: type[BaseException]
) -> None:
    """Before writing, which may take a while, it says that it stops."""
    run = TrainingRun(settings.out, settings, resume=False, go_on="python mine.py --resume")
    with pytest.raises(kind), run.saving({"net": constant_network(1.0)}, 1e9) as keep:
        keep(10, {})
        keep(20, {})
        raise kind
    said = capsys.readouterr().err.split("\n")
    assert said[1] == f"stopping: saving the run in '{settings.out}'"
    assert said[3].startswith("interrupted after 20 policy steps; saved in ")
    assert said[3].endswith("checkpoint-000000000020.zip'")
    assert said[4] == "to continue: python mine.py --resume"
    assert saved_steps(settings) == [10, 20]


def test_an_interrupted_training_says_that_there_is_nothing_to_save(
    settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    run = open_run(settings)
    with pytest.raises(KeyboardInterrupt), run.saving({"net": constant_network(1.0)}, 0.0):
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert "before the first update" in said
    assert "to continue: resume=True" in said


def test_an_interrupted_training_says_what_could_not_be_saved(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = open_run(settings)
    save_steps(run, 10)
    monkeypatch.setattr(run_module, "save_checkpoint", fail_on_full_disk)
    with pytest.raises(KeyboardInterrupt), run.saving({"net": constant_network(5.0)}, 1e9) as keep:
        keep(20, {})
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert "the checkpoint of 20 policy steps could not be written" in said
    assert "continues from the checkpoint of 10 steps" in said


def test_an_error_names_its_cause_and_the_checkpoint_to_resume_from(settings: Settings) -> None:
    run = open_run(settings)
    with (
        pytest.raises(TrainingStoppedError) as info,
        quiet() as said,
        run.saving({"net": constant_network(1.0)}, 0.0) as keep,
    ):
        keep(10, {})
        raise ValueError("the robot has left")
    assert "10 policy steps by ValueError: the robot has left" in str(info.value)
    assert "--resume continues from the checkpoint of 10 steps" in str(info.value)
    assert isinstance(info.value.__cause__, ValueError)
    assert said == ["training stopped"]


def test_an_error_before_the_first_update_leaves_no_checkpoint(settings: Settings) -> None:
    run = open_run(settings)
    stopped = pytest.raises(TrainingStoppedError, match="continues from no checkpoint")
    with quiet(), stopped, run.saving({"net": constant_network(1.0)}, 0.0):
        raise ValueError("at once")
    assert checkpoints(settings) == []


@pytest.mark.parametrize("number", ENDINGS)
def test_signals_save_and_exit(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """Further ones, sent by a shell or systemd, and a closed terminal do not disturb the saving."""
    save = run_module.save_checkpoint

    def disturbed(path: Path, *args: Any) -> None:
        if path.stem.endswith("20"):
            for other in ENDINGS:
                os.kill(os.getpid(), other)
        save(path, *args)

    monkeypatch.setattr(run_module, "save_checkpoint", disturbed)
    monkeypatch.setattr("sys.stderr", Mock(write=fail_on_full_disk))
    run = open_run(settings)
    with pytest.raises(SystemExit) as info, run.saving({"net": constant_network(1.0)}, 1e9) as keep:
        for step in (10, 20):
            keep(step, {})
        os.kill(os.getpid(), number)
        pytest.fail("not reached")
    assert info.value.code == 128 + number
    assert saved_steps(settings) == [10, 20]
    assert all(signal.getsignal(other) is signal.SIG_DFL for other in ENDINGS)


def test_signals_that_are_ignored_or_handled_do_not_end_a_training(settings: Settings) -> None:
    """SIGHUP is ignored under nohup, and a user's program may use SIGUSR1 for its own purpose."""
    heard: list[int] = []
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGUSR1, lambda number, _: heard.append(number))
    try:
        with open_run(settings).saving({"net": constant_network(1.0)}, 1e9) as keep:
            keep(10, {})
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGUSR1)
            keep(20, {})
    finally:
        for number in (signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, signal.SIG_DFL)
    assert heard == [signal.SIGUSR1]
    assert saved_steps(settings) == [10, 20]


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
    save_steps(open_run(settings), 10, 20)
    newest = checkpoints(settings)[-1]
    _damage(newest, how)
    net, run = constant_network(0.0), open_run(settings, resume=True)
    with quiet() as said:
        kept = run.restore({"net": net})
    assert kept == {"step": 10, "elapsed_s": 15.0}
    assert (net.weight == 10).all()
    assert any(
        str(newest) in line and "falling back to the previous checkpoint" in line for line in said
    )
    assert [path.name for path in checkpoints(settings)] == [
        "checkpoint-000000000010.zip",
        "checkpoint-000000000020.zip.damaged",
    ]
    save_steps(run, 15)
    with quiet() as said:
        assert open_run(settings, resume=True).restore({"net": net}) == {
            "step": 15,
            "elapsed_s": 22.5,
        }
    assert said == []


@pytest.mark.parametrize("error", [MemoryError(), PermissionError(13, "Permission denied")])
def test_a_checkpoint_that_the_machine_cannot_read_now_is_not_damaged(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """No older one is taken instead of it, and rows of the logs stay."""
    save_steps(open_run(settings), 10, 20)

    def fail(*_: object) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr("aslip.base.archive.read_zip", fail)
        with pytest.raises(type(error)):
            open_run(settings, resume=True).restore({"net": constant_network(0.0)})
    assert saved_steps(settings) == [10, 20]


@pytest.mark.parametrize("how", DAMAGES)
def test_a_run_with_only_damaged_checkpoints_cannot_resume(settings: Settings, how: str) -> None:
    """The error names all, and none is changed: another version may be able to read them."""
    save_steps(open_run(settings), 10, 20)
    paths = checkpoints(settings)
    for path in paths:
        _damage(path, how)
    with quiet(), pytest.raises(FileDamagedError, match="no checkpoint to resume from") as info:
        open_run(settings, resume=True).restore({"net": constant_network(0.0)})
    assert all(path.name in str(info.value) for path in paths)
    assert checkpoints(settings) == paths


def test_a_checkpoint_with_other_components_is_refused(settings: Settings) -> None:
    """A checkpoint of a changed recipe names the missing components, and nothing is loaded."""
    save_steps(open_run(settings), 10)
    others = (
        {"net": torch.nn.Linear(4, 2)},
        {"net": constant_network(0.0), "other": constant_network(0.0)},
    )
    for components, word in zip(others, ("size mismatch", "lacks.*other"), strict=True):
        with quiet(), pytest.raises(FileDamagedError, match=word):
            open_run(settings, resume=True).restore(components)


def test_a_resumed_run_that_stops_at_once_saves_nothing(settings: Settings) -> None:
    save_steps(open_run(settings), 10)
    before = checkpoints(settings)[0].stat().st_mtime_ns
    run = open_run(settings, resume=True)
    components = {"net": constant_network(0.0)}
    run.restore(components)
    with run.saving(components, 0.0):
        pass
    assert checkpoints(settings)[0].stat().st_mtime_ns == before


def test_the_same_checkpoint_is_written_only_once(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, save = [], run_module.save_checkpoint
    monkeypatch.setattr(
        run_module, "save_checkpoint", lambda path, *a: (written.append(path), save(path, *a))
    )
    save_steps(open_run(settings), 10, 20)
    assert written == checkpoints(settings)


def test_temporary_files_of_a_killed_process_are_removed(settings: Settings) -> None:
    save_steps(open_run(settings), 10)
    folder = settings.out / "checkpoints"
    (folder / ".checkpoint-000000000020.zip.stage-1" / "components").mkdir(parents=True)
    (folder / ".checkpoint-000000000020.zip.part").write_bytes(b"half")
    open_run(settings, resume=True)
    assert saved_steps(settings) == [10]
