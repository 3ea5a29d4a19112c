"""Logs of short walks with a push, falls and several episodes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from tensordict import TensorDict
from torchrl.envs.transforms import StepCounter

import aslip
from aslip.envs import default_stack, randomise_stack
from aslip.library import GaitLibrary
from aslip.log import Recorder, Recording, read
from aslip.robot import CASSIE
from tests.log.helpers import Alter, MakeRecorded, run


@pytest.fixture(scope="session")
def make_recorded(library: GaitLibrary) -> MakeRecorded:
    """`aslip.make_env` with a recorder as the last transform."""

    def make(
        path: Path,
        backend: str = "batch",
        num_envs: int = 1,
        *,
        drop: Sequence[str] = (),
        max_steps: int | None = None,
        dynamics: bool = False,
        timestep: float = CASSIE.physics_timestep,
        **settings: Any,
    ) -> Any:
        stack = default_stack(library)
        if max_steps is not None:
            stack["time_limit"] = StepCounter(max_steps=max_steps)
        if dynamics:
            stack = randomise_stack(stack)
        stack["recorder"] = Recorder(path, **settings)
        return aslip.make_env(
            backend,  # pyright: ignore[reportArgumentType]
            num_envs=num_envs,
            seed=4,
            stack=stack,
            drop=drop,
            num_threads=1,
            timestep=timestep,
        )

    return make


@pytest.fixture(scope="session")
def walk(
    make_recorded: MakeRecorded, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[TensorDict]]:
    """Log of 100 policy steps in several episodes, and the tensordicts of the steps."""
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    env = make_recorded(path, policy="straight", config={"why": "a test"})
    seen = run(env, 100)
    assert sum(bool(td["next", "done"]) for td in seen) >= 2
    env.close()
    return path, seen


@pytest.fixture(scope="session")
def recording(walk: tuple[Path, list[TensorDict]]) -> Recording:
    """The log in memory."""
    return read(walk[0])


@pytest.fixture(scope="session")
def log(walk: tuple[Path, list[TensorDict]]) -> Path:
    """File of the log."""
    return walk[0]


@pytest.fixture
def altered(log: Path, tmp_path: Path) -> Alter:
    """Function that writes a copy of the log with changed bytes."""

    def alter(change: Callable[[bytearray], None]) -> Path:
        data = bytearray(log.read_bytes())
        change(data)
        path = tmp_path / "altered.mcap"
        path.write_bytes(data)
        return path

    return alter
