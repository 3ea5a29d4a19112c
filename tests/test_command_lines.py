"""Command lines: parsed before any heavy import, with errors in one style."""

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from aslip.__main__ import COMMANDS
from aslip.base.command_line import Reports, command_line, prepare_program, program, say
from aslip.errors import ConfigurationError, one_line_errors
from aslip.policy import read_card
from aslip.training.run import TrainingRun
from aslip.training.settings import SETTINGS_FILE
from recipes.ppo_settings import (
    PRESETS,
    Config,
    resume_command,
    run_settings,
    training_settings,
    with_schedule,
)
from tests.helpers import started

ROOT = Path(__file__).parent.parent


@dataclass(frozen=True)
class Flags:
    """Flags of a small program."""

    clip: float = 0.2
    total_steps: int = 10

    def __post_init__(self) -> None:
        if self.clip < 0:
            raise ConfigurationError(f"clip must be positive, got {self.clip}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--clip", "-1"], "clip must be positive, got -1.0"),
        (["--total-stps", "5"], "Perhaps you meant: --total-steps"),
        (["--clip", "much"], "--clip"),
    ],
)
def test_a_wrong_argument_is_named_with_a_hint_at_help(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as info:
        command_line(Flags, arguments=arguments)
    assert info.value.code == 2
    output = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert message in output
    assert f"{program()} --help" in output


@pytest.mark.parametrize("kind", [ConfigurationError, FileExistsError])
def test_user_errors_are_one_line(kind: type[Exception]) -> None:
    with pytest.raises(SystemExit, match="error: no such thing"), one_line_errors():
        raise kind("no such thing")
    with pytest.raises(ZeroDivisionError), one_line_errors():
        raise ZeroDivisionError


def test_every_program_has_errors_of_one_line() -> None:
    scripts = [p.read_text() for d in ("recipes", "benchmarks") for p in (ROOT / d).rglob("*.py")]
    programs = [text for text in scripts if "if __name__ ==" in text]
    assert len(programs) >= 20
    assert all("with one_line_errors():" in text for text in programs)


# ---------------------------------------------------------------------- training


@pytest.fixture
def run(tmp_path: Path) -> Config:
    """Settings of a run of the paper's preset in a folder."""
    config = replace(PRESETS["paper"], out=tmp_path / "my run", seed=3, total_steps=1000)
    TrainingRun(config.out, with_schedule(config), resume=False)
    return config


def _settings(*words: str) -> Config:
    return training_settings(PRESETS, words)


def test_a_preset_fills_in_the_settings_that_are_not_given() -> None:
    assert _settings() == PRESETS["default"]
    assert _settings("paper") == PRESETS["paper"]
    assert _settings("paper", "--seed", "3") == replace(PRESETS["paper"], seed=3)
    assert all(config.preset == name for name, config in PRESETS.items())


def test_a_resumed_run_keeps_its_settings(run: Config) -> None:
    """Only the given settings change; more steps do not change the schedule."""
    resume = ["paper", "--resume", "--out", str(run.out)]
    resumed = _settings(*resume)
    assert resumed == replace(run, resume=True, schedule_steps=1000)
    longer = _settings(*resume, "--total-steps", "3000")
    assert longer == replace(resumed, total_steps=3000)
    TrainingRun(run.out, longer, resume=True)
    assert _settings(*resume).total_steps == 3000
    assert _settings(*resume).schedule_steps == 1000


def test_a_run_of_another_version_or_preset_is_refused(
    run: Config, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        _settings("--resume", "--out", str(run.out))
    assert f"paper --resume --out '{run.out}'" in capsys.readouterr().err
    file = run.out / SETTINGS_FILE
    file.write_text(file.read_text().replace('"clip"', '"old_clip"'))
    with pytest.raises(ConfigurationError, match=r"another version.*\['old_clip'\]"):
        run_settings(run.out, PRESETS["paper"])
    with pytest.raises(SystemExit):
        _settings("paper", "--resume", "--out", str(run.out))
    assert "error: the run in" in capsys.readouterr().err


def test_a_folder_without_a_run_cannot_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        _settings("--resume", "--out", str(tmp_path))
    assert "holds no run to resume" in capsys.readouterr().err


def test_the_command_to_resume_names_preset_and_folder(run: Config) -> None:
    assert resume_command(run) == f"{program()} paper --resume --out '{run.out}'"
    assert resume_command(Config()) == f"{program()} --resume --out runs/ppo_aslip"


_TINY = (
    "--num-envs 8 --samples 64 --minibatch 32 --checkpoint-minutes 0 --total-steps 100000000"
    " --eval-interval 1000000000"
)


# SIGTERM in the process of the test: tests/training/test_run_checkpoints.py
@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_a_training_that_is_interrupted_saves_and_reports_how_to_resume(
    tmp_path: Path, number: signal.Signals
) -> None:
    out, recipe = tmp_path / "run", "recipes/ppo_aslip.py"
    command = [sys.executable, recipe, "--out", str(out), *_TINY.split()]
    with started(command, cwd=ROOT, stderr=subprocess.PIPE) as process:
        until = time.monotonic() + 240
        while not list(out.glob("checkpoints/*.zip")) and time.monotonic() < until:
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.1)
        process.send_signal(number)
        output, errors = process.communicate(timeout=120)
    assert process.returncode == 128 + number
    resume_hint = f"python {recipe} --resume --out {out}"
    assert f"to continue: {resume_hint}" in output
    assert f"to continue: {resume_hint}" in errors
    assert "saved: " in errors
    assert output.startswith(f"{out}: loading ")
    assert f"-{read_card(out)['made_by']['steps']:012d}.zip" in errors
    assert max(out.glob("checkpoints/*.zip")).name in errors


# ----------------------------------------------------------------------- imports

_HEAVY = ("torch", "torchrl", "tensordict", "dm_control", "pinocchio", "casadi", "matplotlib")

_LOADED = """
import contextlib, io, os, runpy, sys
with contextlib.redirect_stderr(io.StringIO()):
    for call in sys.argv[1:]:
        name, *words = call.split()
        for word in ("--help", "--no-such-option"):
            sys.argv = [name, *words, word]
            reader, writer = os.pipe()
            os.close(reader)
            os.dup2(writer, 1)
            os.close(writer)
            sys.stdout = sys.__stdout__ = open(1, "w", encoding="ascii", closefd=False)
            try:
                if name.endswith(".py"):
                    runpy.run_path(name, run_name="__main__")
                else:
                    runpy.run_module(name, run_name="__main__", alter_sys=True)
            except SystemExit as stop:
                assert stop.code == (2 if word != "--help" else 0), (call, word, stop.code)
                sys.stdout.flush()
            else:
                raise AssertionError(f"{call} {word} did not exit")
            found = sorted({module.split(".")[0] for module in sys.modules} & HEAVY)
            assert not found, (call, word, found)
""".replace("HEAVY", repr(set(_HEAVY)))


def _programs() -> list[str]:
    """Programs: scripts by path, modules by name."""
    scripts = [path for path in (ROOT / "recipes").glob("*.py")]
    modules = [path for path in (ROOT / "benchmarks").rglob("*.py")]
    names = [str(path.relative_to(ROOT)) for path in scripts if _runs(path)]
    for path in filter(_runs, modules):
        names.append(".".join(path.relative_to(ROOT).with_suffix("").parts))
    calls = [f"aslip {command}" for command in COMMANDS if command != "measure"]
    return [*sorted(names), "aslip.log", *calls, "aslip measure paper.step_frequency"]


def _runs(path: Path) -> bool:
    return "if __name__ ==" in path.read_text()


def test_help_and_wrong_arguments_need_no_heavy_imports() -> None:
    """Nor a terminal with more than ASCII, nor a reader; all programs in one interpreter."""
    names = [name.removesuffix(".__main__") for name in _programs()]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'recipes'}"}
    result = subprocess.run(
        [sys.executable, "-c", _LOADED, *names],
        cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert len(names) > 30
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("unbuffered", [False, True])
def test_output_that_nobody_reads_is_dropped(
    unbuffered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, writer = os.pipe()
    with open(writer, "wb", buffering=0 if unbuffered else -1) as file:
        stream = io.TextIOWrapper(file, "latin-1", write_through=unbuffered)
        for name in ("stdout", "__stdout__"):
            monkeypatch.setattr(sys, name, stream)
        monkeypatch.setattr(sys, "excepthook", sys.excepthook)
        print("before, ", end="")
        prepare_program()
        print("a \N{BULLET} \N{PLUS-MINUS SIGN}", flush=True)
        assert os.read(reader, 99) == "before, a ? \N{PLUS-MINUS SIGN}\n".encode("latin-1")
        os.close(reader)
        for _ in range(2):
            print("x" * 100_000, flush=True)
        assert os.fstat(writer).st_rdev == os.stat(os.devnull).st_rdev


def test_lines_that_nobody_reads_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A full pipe takes no more, and a terminal may lack characters."""
    read, write = os.pipe()
    with open(write, "w", encoding="ascii") as output:
        monkeypatch.setattr(sys, "stdout", output)
        lines = [f"{i} ü \ud800 {1000 * 'x'}" for i in range(300)]
        start = time.monotonic()
        for line in lines:
            say(line)
        assert time.monotonic() - start < 1.0
        time.sleep(0.05)
        found = os.read(read, 2**20).decode("ascii").splitlines()
        os.close(read)
    assert found[0] == lines[0].encode("ascii", "backslashreplace").decode()
    assert 50 < len(found) < 100


def test_repeated_events_are_one_line_a_second() -> None:
    lines, now = list[str](), [0.0]
    reports = Reports(lines.append, lambda: now[0])
    for _ in range(2560):
        for _ in range(3):
            reports.add("refused", f"at {now[0]:.1f} s")
        reports.say()
        now[0] += 2**-10
    reports.add("client", "new")
    reports.say()
    assert lines == [
        *("at 0.0 s (3 times)", "at 1.0 s (3072 times)", "at 2.0 s (3072 times)", "new"),
    ]
