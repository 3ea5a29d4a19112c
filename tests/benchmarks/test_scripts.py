"""Recipes and benchmarks run from start to end on small settings."""

import json
import math
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.envs import ParallelEnv, SerialEnv

from aslip import GaitLibrary
from aslip.base.assets import asset_path
from aslip.errors import (
    ConfigurationError,
    FileDamagedError,
    SpeedOutOfRangeError,
    one_line_errors,
)
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, save_policy
from aslip.training.progress import steps_done
from benchmarks.gaits import solve
from benchmarks.paper import film_strip
from benchmarks.scorecard import learning_curves
from benchmarks.system import estimator, export_speed, logs, throughput
from recipes import gait_library, ppo_aslip
from recipes.ppo_directions import DirectionConfig
from recipes.ppo_settings import PRESETS, training_settings
from tests.helpers import TINY


@pytest.mark.parametrize("kind", [ConfigurationError, FileExistsError])
def test_user_errors_are_one_line(kind: type[Exception]) -> None:
    with pytest.raises(SystemExit, match="error: no such thing"), one_line_errors():
        raise kind("no such thing")
    with pytest.raises(ZeroDivisionError), one_line_errors():
        raise ZeroDivisionError


def test_every_script_uses_one_line_errors() -> None:
    root = Path(__file__).parents[2]
    scripts = [p.read_text() for d in ("recipes", "benchmarks") for p in (root / d).rglob("*.py")]
    programs = [text for text in scripts if "if __name__ ==" in text]
    assert len(programs) >= 20
    assert all("with one_line_errors():" in text for text in programs)


def test_builds_library_of_other_speeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = gait_library.Config(
        out=tmp_path / "mine.npz", speeds=(0.5, 0.75), samples=32, pictures=tmp_path
    )
    gait_library.main(config)
    library = GaitLibrary.load(tmp_path / "mine.npz")
    assert library.speeds.tolist() == [0.5, 0.75]
    assert library.made_by["command"].startswith("python ")
    for picture in ("gait.png", "gaits.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    table = capsys.readouterr().out
    assert "KKT" in table
    assert " 0.8025 " in table


def test_refuses_to_replace_shipped_library() -> None:
    with pytest.raises(ConfigurationError, match=r"give another file with --out"):
        gait_library.Config(speeds=(0.5, 1.0))


def test_a_library_of_impossible_speeds_leaves_no_file(tmp_path: Path) -> None:
    config = gait_library.Config(out=tmp_path / "mine.npz", speeds=(0.5, 9.0), pictures=tmp_path)
    with pytest.raises(SpeedOutOfRangeError, match="9"):
        gait_library.main(config)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("parallel", [SerialEnv, pytest.param(ParallelEnv, marks=pytest.mark.slow)])
def test_throughput_reports_every_candidate(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, parallel: type
) -> None:
    """In the fast tests without other processes."""
    monkeypatch.setattr(throughput, "ParallelEnv", parallel)
    config = throughput.Config(
        num_envs=(1, 2), num_threads=(1,), rounds=1, robot_steps=1, single=1, updates=False
    )
    throughput.main(config)
    rows = [line for line in capsys.readouterr().out.splitlines() if line[:3] in ("| 1", "| 2")]
    assert len(rows) == 9 + 7
    assert all(row.endswith("% |") for row in rows)


@pytest.mark.slow
def test_draws_gaits_in_several_directions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = solve.Config(commands=((0.5, 0.2, 0.3),), picture=tmp_path / "paths.png")
    (gait,) = solve.main(config)
    assert gait.command.tolist() == [0.5, 0.2, 0.3]
    assert config.picture.read_bytes().startswith(b"\x89PNG")
    assert "| 0.5, 0.2, 0.3 |" in capsys.readouterr().out


@pytest.mark.slow
def test_throughput_reports_learning_and_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ppo_aslip, "PRESETS", {"default": TINY})
    config = throughput.Config(num_envs=(2,), rounds=2)
    row = throughput.update_table(config).splitlines()[-1]
    assert row.startswith("| default | 64 | ")
    *_, share, copied, saved, _ = row.split("|")
    assert 0 < float(share.strip(" %")) < 100
    assert math.isfinite(float(copied))
    assert math.isfinite(float(saved))
    assert 0.1 < float(throughput.memory_table(config).splitlines()[-1].split("|")[2]) < 8


def test_estimator_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimator, "_AGES", ((0, 1), (1, 4), (4, 20)))
    config = estimator.Config(
        steps=12,
        repeats=1,
        falls=2,
        num_envs=2,
        rounds=1,
        out=tmp_path,
    )
    estimator.main(config)
    printed = capsys.readouterr().out
    assert [line[:7] for line in printed.splitlines() if line[2:3] in "012"][:5] == [
        f"| {speed:.1f} |" for speed in (0.0, 0.5, 1.0, 1.5, 2.0)
    ]
    assert "estimator and noise" in printed
    numbers = json.loads((tmp_path / "estimator.json").read_text())
    assert all(max(row["velocity"]) < 0.3 for row in numbers["walks"])
    assert sum(row["samples"] for row in numbers["recovery"]) > 0
    assert (tmp_path / "estimator.png").read_bytes().startswith(b"\x89PNG")


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


@pytest.mark.parametrize("begun", [False, True])
def test_started_training_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    """Even if it was killed before its first checkpoint and has a learning curve."""
    commands: list[list[str]] = []
    monkeypatch.setattr(
        learning_curves.subprocess, "Popen", lambda command, **_: commands.append(command)
    )
    if begun:
        curves_of(tmp_path / "default-0", walks_at=300, steps=20)
        (tmp_path / "default-0" / "config.json").write_text("{}")
    learning_curves._start(curves_config(tmp_path, schedule_steps=7000), "default", 0, 0)
    assert [command[-1] == "--resume" for command in commands] == [begun]
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
    # the same library elsewhere, another one, and none
    same = shutil.copy(asset_path("directions.npz"), tmp_path / "same.npz")
    path.write_text(json.dumps({**settings, "library": same}, default=str))
    learning_curves.main(config)
    for other in ("gaits", "built/elsewhere.npz"):
        path.write_text(json.dumps({**settings, "library": other}, default=str))
        with pytest.raises(ConfigurationError, match=rf"with seed 0.*{other}"):
            learning_curves.main(config)
    path.write_text(json.dumps({**settings, "schedule_steps": 90_000}, default=str))
    with pytest.raises(ConfigurationError, match="ends after 90000 policy steps, not after 600000"):
        learning_curves.main(config)
    commands: list[list[str]] = []
    monkeypatch.setattr(
        learning_curves.subprocess, "Popen", lambda command, **_: commands.append(command)
    )
    learning_curves._start(config, "directions", 0, 0)
    assert Path(commands[0][1]).name == "ppo_directions.py"


def test_baseline_learns_with_the_settings_of_the_paper() -> None:
    baseline = training_settings(PRESETS, learning_curves.VARIANTS["baseline"])
    assert baseline.preset == "single-reference"
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
def test_black_box_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "_EPISODE", 40)
    config = logs.Config(rounds=1, kills=1, cuts=4, replays=1, report=tmp_path / "black_box.json")
    logs.main(config)
    printed = capsys.readouterr().out
    assert "| joints at 2 kHz |" in printed
    numbers = json.loads((tmp_path / "black_box.json").read_text())
    assert numbers["kills"]["failures"] == 0
    assert numbers["cuts"]["wrong"] == 0
    assert numbers["replays"]["equal"] == 1
    assert numbers["overhead"]["physics_bytes"] > numbers["overhead"]["policy_bytes"]


@pytest.mark.usefixtures("pictures")
def test_a_film_strip_is_drawn(tmp_path: Path) -> None:
    small = {"frames": 2, "settle": 0.0, "width": 80, "height": 100}
    for reference in (False, True):
        out = tmp_path / f"{reference}.png"
        film_strip.main(film_strip.Config(out=out, reference=reference, **small))
        assert out.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_learning_curves_train_missing_runs_and_resume(tmp_path: Path) -> None:
    settings = {"out": tmp_path, "seeds": (0,), "schedule_steps": 8192, "jobs": 2}
    settings["picture"] = tmp_path / "curves.png"
    for steps in (4096, 8192):
        learning_curves.main(learning_curves.Config(total_steps=steps, **settings))
        for variant in ("truth", "default"):
            assert steps_done(tmp_path / f"{variant}-0") == steps


@pytest.mark.slow
def test_exported_policies_start_lighter_than_pytorch(capsys: pytest.CaptureFixture[str]) -> None:
    export_speed.main(export_speed.Config(starts=1, steps=10))
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines() if "|" in line]
    memory = {row[1].strip(): float(row[3]) for row in rows[2:]}
    assert memory["ONNX"] < memory["PyTorch"] / 2
