"""Folder of a run: kept settings, never overwritten, resumed with its own settings."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.training import loop
from aslip.training import run as run_module
from aslip.training.loop import training_loop
from aslip.training.progress import Progress
from tests.training.run_folder import Settings, constant_network, open_run
from tests.training.trainings import quiet


@pytest.mark.parametrize(
    "name", ["checkpoints/checkpoint-1.zip", "progress.csv", "policy.zip", "config.json"]
)
def test_a_run_and_its_remains_are_not_overwritten(settings: Settings, name: str) -> None:
    """A checkpoint, a learning curve, a policy, or settings of another program."""
    (settings.out / name).parent.mkdir(parents=True)
    (settings.out / name).write_text('{"other": "thing"}')
    with pytest.raises(ConfigurationError, match=r"holds a run already.*--resume.*--out"):
        open_run(settings)
    assert [file for file in settings.out.rglob("*") if file.is_file()] == [settings.out / name]
    assert (settings.out / name).read_text() == '{"other": "thing"}'


def test_a_run_without_a_checkpoint_may_be_overwritten(settings: Settings) -> None:
    open_run(settings)
    open_run(settings)


def test_an_empty_folder_cannot_be_resumed(settings: Settings) -> None:
    with pytest.raises(ConfigurationError, match="holds no run to resume"):
        open_run(settings, resume=True)
    assert not settings.out.exists()


def test_a_resumed_run_without_a_checkpoint_starts_from_the_beginning(settings: Settings) -> None:
    run = open_run(settings)
    run.log(10, {"value": 1.0})
    with quiet() as messages:
        again = open_run(settings, resume=True)
        assert again.restore({"net": constant_network(0.0)}) is None
    assert "starts from the beginning" in messages[0]
    assert again.history() == {}
    again.log(10, {"value": 2.0})
    assert again.history() == {"step": [10], "value": [2.0]}


def test_damaged_settings_are_named(settings: Settings) -> None:
    open_run(settings)
    for text in ("", '{"seed": 0', "3"):
        (settings.out / "config.json").write_text(text)
        with pytest.raises(FileDamagedError, match=r"config\.json"):
            open_run(settings, resume=True)


@pytest.mark.parametrize("resume", [False, True])
def test_an_unwritable_folder_is_refused_at_once(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, resume: bool
) -> None:
    open_run(settings)

    def deny(*args: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(run_module, "write_text", deny)
    with pytest.raises(ConfigurationError, match=r"run' cannot be written to.*denied.*--out"):
        open_run(settings, resume=resume)


def test_a_run_cannot_resume_with_other_settings(settings: Settings) -> None:
    open_run(settings)
    with pytest.raises(ConfigurationError, match=r"seed was 0 and is 4") as info:
        open_run(replace(settings, seed=4), resume=True)
    assert "learning_rate" not in str(info.value)
    assert json.loads((settings.out / "config.json").read_text())["seed"] == 0


def test_a_moved_run_can_resume_with_more_steps(settings: Settings) -> None:
    open_run(settings)
    moved = replace(settings, out=settings.out.with_name("moved"), resume=True, total_steps=500)
    settings.out.rename(moved.out)
    assert open_run(moved, resume=True).changes == ["total_steps 100 -> 500"]
    assert open_run(moved, resume=True).changes == []


def test_the_card_of_a_resumed_run_has_the_command_that_started_it(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = Progress(10, 1).state()
    monkeypatch.setattr("sys.argv", ["recipe.py", "--seed", "4"])
    first = open_run(settings).about(progress)["command"]
    assert first.endswith("--seed 4")
    monkeypatch.setattr("sys.argv", ["recipe.py", "--resume"])
    for _ in range(2):
        assert open_run(settings, resume=True).about(progress)["command"] == first


def test_pytorch_has_no_more_threads_than_a_container_has_processors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads: list[int] = []
    monkeypatch.setattr(loop, "processors", lambda: 2)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 64)
    monkeypatch.setattr(torch, "set_num_threads", threads.append)
    run: Any = SimpleNamespace(restore=lambda parts: 1 / 0)
    settings = SimpleNamespace(resume=True)
    with (
        pytest.raises(ZeroDivisionError),
        training_loop(run, {"collector": None}, settings),
    ):
        pass
    assert threads == [2]
