"""Fixtures of the tests of benchmarks."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from aslip.envs import StackEnv
from aslip.walking import Walker
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], dict[str, Any]]:
    """Function that reads the numbers of a benchmark; its table and picture must exist."""

    def read(name: str) -> dict[str, Any]:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / f"{name}.md").read_text().startswith("|")
        return json.loads((tmp_path / f"{name}.json").read_text())

    return read


@pytest.fixture(scope="session")
def gaits(tmp_path_factory: pytest.TempPathFactory) -> str:
    """File of a small library over three commands."""
    file = tmp_path_factory.mktemp("library") / "gaits.npz"
    symmetric_library().save(file)
    return str(file)


@pytest.fixture(scope="session")
def standing_gaits(tmp_path_factory: pytest.TempPathFactory) -> str:
    """File of a small library with stop and start."""
    file = tmp_path_factory.mktemp("library") / "standing.npz"
    standing_library().save(file)
    return str(file)


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
