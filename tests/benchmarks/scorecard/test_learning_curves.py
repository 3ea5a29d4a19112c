"""Learning curves: reports of runs, their record, and trainings that are started."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, save_policy
from aslip.training.progress import steps_done
from benchmarks.scorecard import learning_curves
from recipes.ppo_directions import DirectionConfig
from recipes.ppo_settings import PRESETS, training_settings


def curves_of(folder: Path, walks_at: int, steps: int = 600, seed: int = 0) -> None:
    """Progress of a run of `steps` thousand policy steps; its last row is incomplete."""
    rng = np.random.default_rng(seed)
    lines = [
        "step,elapsed_s,episode_length,episode_return,divergences,kl,eval_return,eval_survived"
    ]
    for step in range(10, steps + 1, 10):
        length = 395 if step >= walks_at + 100 else 360 if step >= walks_at else 20
        evaluation = f"{step / 2:g},1" if step % 200 == 0 else "nan,nan"
        lines.append(
            f"{step}000,{6 * step},{length},{rng.uniform():.6g},{step // 250},0.01,{evaluation}"
        )
    folder.mkdir(parents=True)
    (folder / "progress.csv").write_text("\n".join([*lines, f"{steps + 10}000,4"]))


def curves_config(out: Path, **settings: Any) -> learning_curves.Config:
    settings = {"total_steps": 600_000, "train": False, **settings}
    return learning_curves.Config(out=out, picture=out / "curves.png", **settings)


def test_learning_curves_report_existing_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    curves_of(tmp_path / "truth-0", walks_at=230)
    curves_of(tmp_path / "default-0", walks_at=240)
    curves_of(tmp_path / "default-2", walks_at=550)
    learning_curves.main(curves_config(tmp_path))
    truth, *default = capsys.readouterr().out.splitlines()[2:]
    assert truth.startswith("| truth | 0 |  | 600 | 60 | 230 | 330 | 395 |")
    assert truth.endswith("| 300 | 100 | 2 |")
    assert default[0].startswith("| default | 0 |  | 600 | 60 | 240 | 340 | 395 |")
    assert default[1].startswith("| default | 2 |  | 600 | 60 | 550 | not yet | 360 |")
    # a mean over the successful seeds alone would hide the other
    assert default[2].startswith("| default | 2 seeds |  | 600 | 60 | 395 [-1574, 2364] | 1 of 2 |")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_record_accumulates_finished_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here, there, record = tmp_path / "here", tmp_path / "there", tmp_path / "curves.csv"
    curves_of(here / "default-0", walks_at=213, seed=1)
    curves_of(here / "paper-0", walks_at=300, steps=590)  # not done
    curves_of(there / "default-1", walks_at=217, seed=2)
    settings = {"variants": ("default", "paper"), "seeds": (0, 1), "record": record}
    learning_curves.main(curves_config(here, **settings))
    assert list(learning_curves.read_record(record)) == [("default", 0)]
    shape = PolicyShape()
    actor = make_actor(RunningNormalizer(shape.observation_size), shape)
    save_policy(there / "default-1" / "policy.zip", actor, shape, {"commit": "0123456789ab+"})
    learning_curves.main(curves_config(there, **settings))
    assert list(learning_curves.read_record(record)) == [("default", 0), ("default", 1)]
    assert "| default | 1 | 0123456+ | 600 |" in capsys.readouterr().out

    # the record agrees with the runs' own files
    curves_of(there / "default-0", walks_at=213, seed=1)
    capsys.readouterr()
    learning_curves.main(curves_config(there, **{**settings, "record": None}))
    from_runs = capsys.readouterr().out
    kept = record.read_bytes()
    learning_curves.main(curves_config(tmp_path / "nothing", **settings))
    assert capsys.readouterr().out == from_runs
    assert record.read_bytes() == kept
    assert len(kept.splitlines()) < 40
    # recorded runs are not trained again
    default = {**settings, "variants": ("default",), "train": True}
    learning_curves.main(curves_config(tmp_path / "nothing", **default))
    assert not list((tmp_path / "nothing").glob("default-*"))


def test_longer_run_replaces_recorded_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reports still show both up to the same number of steps."""
    record = tmp_path / "curves.csv"
    settings = {"variants": ("default",), "seeds": (0,), "record": record}
    for steps in (600, 900, 700):
        folder = tmp_path / str(steps)
        curves_of(folder / "default-0", walks_at=300, steps=steps)
        learning_curves.main(curves_config(folder, **settings))
    assert learning_curves.read_record(record)["default", 0].steps == 900_000
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| default")]
    assert rows == [rows[0]] * 3


def test_record_keeps_concurrent_additions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = tmp_path / "curves.csv"
    settings = {"variants": ("default",), "record": record}

    def train(config: learning_curves.Config, recorded: object) -> None:
        curves_of(tmp_path / "there" / "default-5", walks_at=300)
        there = curves_config(tmp_path / "there", **settings, seeds=(5,))
        learning_curves.main(there)
        curves_of(config.out / "default-4", walks_at=300)

    monkeypatch.setattr(learning_curves, "_train", train)
    learning_curves.main(curves_config(tmp_path / "here", **settings, seeds=(4,), train=True))
    assert list(learning_curves.read_record(record)) == [("default", 4), ("default", 5)]


@pytest.mark.parametrize("started", [False, True])
def test_started_training_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, started: bool
) -> None:
    """Even if it was killed before its first checkpoint and has a learning curve."""
    commands: list[list[str]] = []
    monkeypatch.setattr(
        learning_curves.subprocess, "Popen", lambda command, **_: commands.append(command)
    )
    if started:
        curves_of(tmp_path / "default-0", walks_at=300, steps=20)
        (tmp_path / "default-0" / "config.json").write_text("{}")
    learning_curves._start(curves_config(tmp_path, schedule_steps=7000), "default", 0, 0)
    assert [command[-1] == "--resume" for command in commands] == [started]
    assert commands[0][commands[0].index("--schedule-steps") + 1] == "7000"


def test_walks_in_all_directions_have_their_own_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose settings are checked, too."""
    curves_of(tmp_path / "directions-0", walks_at=300)
    path = tmp_path / "directions-0" / "config.json"
    settings = asdict(DirectionConfig(total_steps=600_000))
    path.write_text(json.dumps(settings, default=str))
    config = curves_config(tmp_path, variants=("directions",), seeds=(0,))
    learning_curves.main(config)
    path.write_text(json.dumps({**settings, "randomise_share": 1.0}, default=str))
    with pytest.raises(ConfigurationError, match=r"not 'directions' with seed 0.*randomise_share"):
        learning_curves.main(config)
    commands: list[list[str]] = []
    monkeypatch.setattr(
        learning_curves.subprocess, "Popen", lambda command, **_: commands.append(command)
    )
    learning_curves._start(config, "directions", 0, 0)
    assert commands[0][1:5] == ["-m", "aslip", "train", "directions"]


def test_baseline_learns_with_the_settings_of_the_paper() -> None:
    baseline = training_settings(PRESETS, learning_curves.VARIANTS["baseline"])
    assert baseline.preset == "single_reference"
    paper = asdict(PRESETS["paper"])
    other = {name for name, value in asdict(baseline).items() if value != paper[name]}
    assert other == {"preset", "out", "total_steps"}  # the benchmark gives the last two


@pytest.mark.parametrize("done", [600, 300])
def test_run_made_elsewhere_counts_once_it_is_copied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], done: int
) -> None:
    """Finished or not; one of other settings does not pass for it."""
    curves_of(tmp_path / "baseline-10", walks_at=250, steps=done)
    flags = [*learning_curves.VARIANTS["baseline"], "--seed", "10", "--total-steps", "600000"]
    settings = asdict(training_settings(PRESETS, [*flags, "--out", "elsewhere/single-10"]))
    path = tmp_path / "baseline-10" / "config.json"
    config = curves_config(
        tmp_path, variants=("baseline",), seeds=(10,), record=tmp_path / "record.csv"
    )
    path.write_text(json.dumps(settings, default=str))
    learning_curves.main(config)
    assert f"| baseline | 10 |  | {done} |" in capsys.readouterr().out
    assert (tmp_path / "record.csv").exists() == (done == 600)
    for name, value in {"seed": 11, "last_std": 0.05, "preset": "paper"}.items():
        path.write_text(json.dumps({**settings, name: value}, default=str))
        with pytest.raises(ConfigurationError, match=rf"'baseline' with seed 10.*'{name}'"):
            learning_curves.main(config)


def test_error_names_progress_with_missing_columns(tmp_path: Path) -> None:
    (tmp_path / "default-0").mkdir()
    (tmp_path / "default-0" / "progress.csv").write_text("step,elapsed_s\n100,1\n")
    with pytest.raises(FileDamagedError, match=r"default-0.*lacks.*episode_length"):
        learning_curves.main(curves_config(tmp_path))


def test_error_names_damaged_record(tmp_path: Path) -> None:
    record = tmp_path / "curves.csv"
    for damage in ("variant,seed,commit,step\n", "default,0,abc,1\n", "default,zero,abc,1,1,1\n"):
        header = f"variant,seed,commit,{','.join(learning_curves.COLUMNS)}\n"
        record.write_text(damage + "default,0,abc\n" if "variant" in damage else header + damage)
        with pytest.raises(FileDamagedError, match=r"curves\.csv"):
            learning_curves.main(curves_config(tmp_path, record=record))
    rows = [f"{header}default,0,abc,nan,1,1,1,1,1,1\n", "notes of mine\n", ""]
    for text in rows:
        record.write_text(text)
        with pytest.raises(FileDamagedError, match=r"curves\.csv"):
            learning_curves.main(curves_config(tmp_path, record=record))
        assert record.read_text() == text


@pytest.mark.slow
def test_learning_curves_train_missing_runs_and_resume(tmp_path: Path) -> None:
    settings = {"out": tmp_path, "seeds": (0,), "schedule_steps": 8192, "jobs": 2}
    settings["picture"] = tmp_path / "curves.png"
    for steps in (4096, 8192):
        learning_curves.main(learning_curves.Config(total_steps=steps, **settings))
        for variant in ("truth", "default"):
            assert steps_done(tmp_path / f"{variant}-0") == steps
