"""The command `aslip`: its programs, their names, and where they are found."""

from __future__ import annotations

import importlib
import importlib.machinery
import sys
from pathlib import Path

import pytest

from aslip import __main__, programs
from aslip.base import command_line

ROOT = Path(__file__).parent.parent


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Program that the last call of `run` started, its own name, and its arguments."""
    monkeypatch.setattr(command_line, "_program", "")
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr(sys, "path", [*sys.path])
    found: list[str] = []
    monkeypatch.setattr(
        __main__.runpy,
        "run_module",
        lambda name, **_: found.extend([name, command_line.this_command()]),
    )
    return found


def _run(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/usr/bin/aslip", *words.split()])
    __main__.main()


@pytest.mark.parametrize(
    ("words", "program", "name"),
    [
        ("train paper --seed 1", "recipes.ppo_aslip", "aslip train paper --seed 1"),
        ("train directions --resume", "recipes.ppo_directions", "aslip train directions --resume"),
        ("live --port 80", "recipes.walk", "aslip walk --live --port 80"),
        ("log check a", "aslip.log", "aslip log check a"),
        ("measure paper.step_frequency", "benchmarks.paper.step_frequency", ""),
    ],
)
def test_the_first_words_name_the_program(
    words: str, program: str, name: str, call: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _run(words, monkeypatch)
    assert call == [program, name or f"aslip {words}"]


@pytest.mark.parametrize(
    ("words", "wrong", "right"),
    [
        ("wlak --seed 1", "'wlak'", "walk, live"),
        ("measure paper.step", "'paper.step'", "frequency"),
    ],
)
@pytest.mark.usefixtures("call")
def test_wrong_names_are_answered_with_the_right_ones(
    words: str,
    wrong: str,
    right: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match="2"):
        _run(words, monkeypatch)
    error = capsys.readouterr().err
    assert wrong in error and right in error


@pytest.mark.usefixtures("call")
def test_help_is_one_screen_with_every_program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _run("--help", monkeypatch)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) < 25 and max(map(len, lines)) <= 80
    started = {program for program, _ in __main__.COMMANDS.values()}
    recipes = {f"recipes.{p.stem}" for p in (ROOT / "recipes").glob("*.py") if _runs(p)}
    assert recipes == {program for program in started if program.startswith("recipes")}
    _run("measure", monkeypatch)
    listed = capsys.readouterr().out
    measures = [p for p in (ROOT / "benchmarks").rglob("*.py") if _runs(p)]
    assert len(measures) > 20
    assert all(f"  {p.parent.name}.{p.stem} " in listed for p in measures)


def _runs(path: Path) -> bool:
    return "if __name__ ==" in path.read_text()


def test_programs_of_other_packages_are_not_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although they come first on the path: TorchRL installs `benchmarks`, too."""
    for name in ("benchmarks", "recipes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    importlib.reload(programs)
    for name in ("benchmarks", "recipes"):
        found = importlib.machinery.PathFinder.find_spec(name)
        assert found is not None and found.origin == str(ROOT / name / "__init__.py")
