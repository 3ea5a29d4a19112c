"""Benchmarks close their environments, even if a robot falls."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aslip.envs import StackEnv
from aslip.library import GaitLibrary
from aslip.walking import Walker
from benchmarks.common import Subject
from benchmarks.paper import film_strip, ground_force
from benchmarks.system import estimate_errors, estimator, throughput


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Check that each environment that a test makes is closed at the end."""
    envs: list[StackEnv] = []
    closed: list[StackEnv] = []
    construct, close = StackEnv.__init__, StackEnv.close

    def constructing(self: StackEnv, *arguments: Any) -> None:
        construct(self, *arguments)
        envs.append(self)

    def closing(self: StackEnv, **settings: Any) -> None:
        closed.append(self)
        close(self, **settings)

    monkeypatch.setattr(StackEnv, "__init__", constructing)
    monkeypatch.setattr(StackEnv, "close", closing)
    yield
    assert envs
    assert {id(env) for env in envs} == {id(env) for env in closed}


@pytest.fixture
def falling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make each walker fall in its third step."""
    step = Walker.step

    def stumbling(self: Walker) -> Any:
        td = step(self)
        self.fallen = self.steps >= 3
        return td

    monkeypatch.setattr(Walker, "step", stumbling)


@pytest.mark.usefixtures("made", "falling")
def test_ground_reaction_closes_after_fall(library: GaitLibrary) -> None:
    config = ground_force.Config()
    assert ground_force.vertical_forces(config, library, Subject.load("straight"), 1.0) is None


@pytest.mark.usefixtures("made", "falling")
def test_film_strip_closes_after_fall(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="the robot fell"):
        film_strip.main(film_strip.Config(out=tmp_path / "strip.png"))


@pytest.mark.usefixtures("made")
@pytest.mark.parametrize("part", [estimator.throughput, estimator.packet_time, estimator.recovery])
def test_estimator_benchmark_closes_environments(part: Any) -> None:
    config = estimator.Config(repeats=1, steps=2, falls=2, num_envs=2, rounds=1)
    part(config, Subject.load("straight"))


@pytest.mark.usefixtures("made")
def test_record_estimates_closes_environment() -> None:
    estimate_errors.record_estimates(Subject.load("straight"), steps=2, repeats=1, seed=0)


@pytest.mark.usefixtures("made")
def test_memory_measurements_close_environments() -> None:
    throughput.memory_of(1)
