"""Checkpoints of a run: rotation, interruption, and resuming from the newest intact one."""

import os
import signal
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch

from aslip.base.processes import ENDINGS
from aslip.errors import ConfigurationError, FileDamagedError
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


def test_the_last_three_checkpoints_are_kept(settings: Settings) -> None:
    run = open_run(settings)
    save_steps(run, 10, 20, 30)
    assert saved_steps(settings) == [10, 20, 30]
    save_steps(run, 40, 50)
    assert saved_steps(settings) == [30, 40, 50]


def test_checkpoints_are_written_at_the_given_interval(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first is written at once, the last at the end, and those that are called due."""
    now, run = [1000.0], open_run(settings)
    monkeypatch.setattr(run_module.time, "monotonic", lambda: now[0])
    found = []
    net, policies = constant_network(0.0), []
    with run.checkpointing({"net": net}, 2.0, lambda *state: policies.append(state)) as checkpoint:
        for step in range(1, 7):
            checkpoint(step, {"weight": step}, due=step == 5)
            found.append(saved_steps(settings))
            now[0] += 50.0
            torch.nn.init.constant_(net.weight, step)
    assert found == [[1], [1], [1], [1, 4], [1, 4, 5], [1, 4, 5]]
    assert saved_steps(settings) == [4, 5, 6]
    # each checkpoint has a policy, with the weights of the copy
    assert [about["step"] for _, about in policies] == [1, 4, 5, 6]
    assert [float(states["net"]["weight"][0, 0]) for states, _ in policies] == [0, 3, 4, 5]


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
        with quiet(), pytest.raises(seen), run.checkpointing({"net": net}, 1e9) as checkpoint:
            for before in (step - 2, step - 1, step):
                checkpoint(before, {})
            torch.nn.init.constant_(net.weight, -1.0)
            raise raised
        restored = constant_network(0.0)
        kept = open_run(settings, resume=True).restore({"net": restored})
        assert kept == {"step": step}
        assert (restored.weight == step).all()


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_training_names_its_checkpoint_and_how_to_resume(
    settings: Settings, capsys: pytest.CaptureFixture[str], kind: type[BaseException]
) -> None:
    """Before writing, which may take a while, it says that it stops."""
    run = TrainingRun(settings.out, settings, resume=False, resume_hint="python mine.py --resume")
    with pytest.raises(kind), run.checkpointing({"net": constant_network(1.0)}, 1e9) as checkpoint:
        checkpoint(10, {})
        checkpoint(20, {})
        raise kind
    lines = capsys.readouterr().err.split("\n")
    assert lines[1] == f"stopping: saving the run in '{settings.out}'"
    assert lines[3].startswith("training stopped after 20 policy steps; saved: ")
    assert lines[3].endswith("checkpoint-000000000020.zip")
    assert lines[4] == "to continue: python mine.py --resume"
    assert saved_steps(settings) == [10, 20]


@pytest.mark.parametrize(
    ("steps", "saved"),
    [((10,), "checkpoint-000000000010.zip"), ((), "nothing, as no update was complete")],
)
def test_an_error_names_its_cause_and_the_checkpoint_to_resume_from(
    settings: Settings, steps: tuple[int, ...], saved: str
) -> None:
    run, net = open_run(settings), {"net": constant_network(1.0)}
    stopped = pytest.raises(
        TrainingStoppedError, match="by ValueError: the robot has left; saved: "
    )
    with stopped as info, quiet() as messages, run.checkpointing(net, 0.0) as checkpoint:
        for step in steps:
            checkpoint(step, {})
        raise ValueError("the robot has left")
    assert f"{saved}\nto continue: resume=True" in str(info.value)
    assert isinstance(info.value.__cause__, ValueError)
    assert messages == ["training stopped"]
    assert saved_steps(settings) == [*steps]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ConfigurationError("not finite")])
def test_a_policy_that_is_interrupted_is_written_again_and_one_that_cannot_be_stops(
    settings: Settings, error: Any
) -> None:
    policy = Mock(side_effect=[error, None if error is KeyboardInterrupt else error])
    net = {"net": constant_network(1.0)}
    ending = KeyboardInterrupt if error is KeyboardInterrupt else TrainingStoppedError
    with (
        quiet(), pytest.raises(ending) as info,
        open_run(settings).checkpointing(net, 0.0, policy) as checkpoint,
    ):  # fmt: skip
        checkpoint(10, {})
    assert policy.call_count == 2
    assert saved_steps(settings) == [10]
    if ending is TrainingStoppedError:
        assert "after 10 policy steps by ConfigurationError: not finite" in str(info.value)
        assert "saved: " in str(info.value)


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
    net = {"net": constant_network(1.0)}
    with pytest.raises(SystemExit) as info, run.checkpointing(net, 1e9) as checkpoint:
        for step in (10, 20):
            checkpoint(step, {})
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
        with open_run(settings).checkpointing({"net": constant_network(1.0)}, 1e9) as checkpoint:
            checkpoint(10, {})
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGUSR1)
            checkpoint(20, {})
    finally:
        for number in (signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, signal.SIG_DFL)
    assert heard == [signal.SIGUSR1]
    assert saved_steps(settings) == [10, 20]


def _damage(path: Path) -> None:
    """Change one byte of a file's largest part."""
    whole = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda info: info.file_size)
    whole[largest.header_offset + 200] ^= 1
    path.write_bytes(whole)


def test_a_damaged_newest_checkpoint_falls_back_to_the_previous_one(settings: Settings) -> None:
    """A message says so, and the damaged file is renamed, so that it cannot block new ones."""
    save_steps(open_run(settings), 10, 20)
    newest = checkpoints(settings)[-1]
    _damage(newest)
    net, run = constant_network(0.0), open_run(settings, resume=True)
    with quiet() as messages:
        kept = run.restore({"net": net})
    assert kept == {"step": 10, "elapsed_s": 15.0}
    assert (net.weight == 10).all()
    assert any(
        str(newest) in line and "falling back to the previous checkpoint" in line
        for line in messages
    )
    assert [path.name for path in checkpoints(settings)] == [
        "checkpoint-000000000010.zip",
        "checkpoint-000000000020.zip.damaged",
    ]
    save_steps(run, 15)
    with quiet() as messages:
        assert open_run(settings, resume=True).restore({"net": net}) == {
            "step": 15,
            "elapsed_s": 22.5,
        }
    assert messages == []


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


def test_a_run_with_only_damaged_checkpoints_cannot_resume(settings: Settings) -> None:
    """The error names all, and none is changed: another version may be able to read them."""
    save_steps(open_run(settings), 10, 20)
    paths = checkpoints(settings)
    for path in paths:
        _damage(path)
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


def test_temporary_files_of_a_killed_process_are_removed(settings: Settings) -> None:
    save_steps(open_run(settings), 10)
    folder = settings.out / "checkpoints"
    (folder / ".checkpoint-000000000020.zip.stage-1" / "components").mkdir(parents=True)
    (folder / ".checkpoint-000000000020.zip.part").write_bytes(b"half")
    open_run(settings, resume=True)
    assert saved_steps(settings) == [10]
