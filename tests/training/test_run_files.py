"""Files of a run: full disks, rows of progress, TensorBoard."""

import subprocess
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aslip.base.provenance import peak_memory
from aslip.errors import FileDamagedError
from aslip.training import run as run_module
from aslip.training.run import TrainingStoppedError
from tests.helpers import full_disk
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

# --------------------------------------------------------------------- full disk


def test_training_continues_on_a_full_disk(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Existing checkpoints stay; the next checkpoint is another attempt."""
    run = open_run(settings)
    save_steps(run, 10)
    before = checkpoints(settings)[0].read_bytes()
    with quiet() as messages, run.checkpointing({"net": constant_network(5.0)}, 0.0) as checkpoint:
        with monkeypatch.context() as patch:
            patch.setattr(run_module, "save_checkpoint", fail_on_full_disk)
            checkpoint(20, {})
        assert saved_steps(settings) == [10]
        assert checkpoints(settings)[0].read_bytes() == before
        checkpoint(30, {})
    assert ["20 policy steps could not be written" in line for line in messages] == [True]
    assert "No space left on device" in messages[0]
    assert saved_steps(settings) == [10, 30]


def test_a_last_checkpoint_that_cannot_be_written_is_an_error(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = open_run(settings)
    save_steps(run, 10)
    monkeypatch.setattr(run_module, "save_checkpoint", fail_on_full_disk)
    stopped = pytest.raises(TrainingStoppedError)
    with (
        quiet(),
        stopped as info,
        run.checkpointing({"net": constant_network(5.0)}, 0.0) as checkpoint,
    ):
        checkpoint(20, {})
    assert "the checkpoint of 20 policy steps could not be written" in str(info.value)
    assert "saved: " in str(info.value)
    assert "checkpoint-000000000010.zip" in str(info.value)


def test_rows_wait_for_space_on_the_disk(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No checkpoint is written before the rows up to it."""
    run = open_run(settings)
    run.log(10, {"value": 1.0})
    with quiet() as messages, monkeypatch.context() as patch:
        patch.setattr(Path, "open", fail_on_full_disk)
        run.log(20, {"value": 2.0})
        run.log(30, {"value": 3.0})
        with pytest.raises(TrainingStoppedError):
            save_steps(run, 30)
    assert ["could not be written" in line for line in messages] == [True, True, True]
    assert saved_steps(settings) == []
    assert run.history()["step"] == [10]
    save_steps(run, 30)
    assert run.history() == {"step": [10, 20, 30], "value": [1.0, 2.0, 3.0]}
    run.log(40, {"value": 4.0})
    assert run.history()["step"] == [10, 20, 30, 40]


def test_a_partly_written_row_is_removed(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = open_run(settings)
    run.log(10, {"value": 1.0})
    before = (settings.out / "progress.csv").read_bytes()
    run.close()  # TensorBoard writes in a thread, to which the limit must not apply
    with quiet() as messages, full_disk(len(before) + 3):
        run.log(20, {"value": 2.0})
    assert "could not be written" in messages[0]
    assert (settings.out / "progress.csv").read_bytes() == before
    run.log(30, {"value": 3.0})
    assert run.history()["step"] == [10, 20, 30]


# ---------------------------------------------------------------------- csv


def test_a_half_written_row_is_ignored(settings: Settings) -> None:
    run = open_run(settings)
    run.log(10, {"value": 1.0, "other": 2.0})
    with (settings.out / "progress.csv").open("a") as file:
        file.write("20,3.")
    assert run.history() == {"step": [10], "value": [1.0], "other": [2.0]}
    with (settings.out / "progress.csv").open("a") as file:
        file.write(",na")
    assert run.history() == {"step": [10], "value": [1.0], "other": [2.0]}


def test_a_damaged_row_is_named_and_does_not_prevent_resuming(settings: Settings) -> None:
    run = open_run(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": 1.0})
    save_steps(run, 30)
    file = settings.out / "progress.csv"
    file.write_bytes(file.read_bytes().replace(b"20,1", b"\xff0,1"))
    with pytest.raises(FileDamagedError, match=r"line 3 of .*progress\.csv"):
        run.history()
    again = open_run(settings, resume=True)
    kept = again.restore({"net": constant_network(0.0)})
    assert kept is not None
    assert kept["step"] == 30
    assert again.history() == {"step": [10, 30], "value": [1.0, 1.0]}


def test_rows_after_the_checkpoint_are_dropped_on_resume(settings: Settings) -> None:
    """New rows are complete, even if the last one was cut off."""
    run = open_run(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": step / 7, "other": float("nan")})
        if step == 20:
            save_steps(run, step)
    before = run.history()
    with (settings.out / "progress.csv").open("a") as file:
        file.write("4")
    text = (settings.out / "progress.csv").read_text().splitlines()
    again = open_run(settings, resume=True)
    again.restore({"net": constant_network(0.0)})
    again.log(30, {"value": 9.0, "other": 1.0})
    history = again.history()
    assert history["step"] == [10, 20, 30]
    assert history["value"] == [*before["value"][:2], 9.0]
    after = (settings.out / "progress.csv").read_text().splitlines()
    assert after == [*text[:3], "30,9,1"]


def test_tensorboard_points_after_the_checkpoint_are_dropped_on_resume(settings: Settings) -> None:
    """TensorBoard drops them, as the event file records the resumed step."""
    run = open_run(settings)
    for step in (10, 20, 30):
        run.log(step, {"value": float(step)})
        if step == 20:
            save_steps(run, step)
    run.close()
    for file in (settings.out / "tensorboard").glob("events.*"):
        # as if written in another second: TensorBoard reads files in the order of their names
        file.rename(file.with_name(file.name.replace("tfevents.", "tfevents.0")))
    again = open_run(settings, resume=True)
    again.restore({"net": constant_network(0.0)})
    for step in (30, 40):
        again.log(step, {"value": step + 0.5})
    again.close()
    events = EventAccumulator(str(settings.out / "tensorboard")).Reload().Scalars("value")
    assert [(e.step, e.value) for e in events] == [(10, 10), (20, 20), (30, 30.5), (40, 40.5)]


def test_peak_memory_is_that_of_this_process_alone() -> None:
    """On Linux, getrusage includes the peak of the parent process."""
    burden = bytearray(2**30)
    code = (
        "from aslip.base.provenance import peak_memory\n"
        "block = bytearray(2**27); print(peak_memory())"
    )
    command = [sys.executable, "-c", code]
    shown = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    assert peak_memory() > len(burden) / 2**30
    assert 0.125 < float(shown) < 1.0
