"""Fixtures of all tests: the shipped gait library and small environments."""

import os
import signal
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch

import aslip
from aslip.envs import StackEnv
from aslip.errors import RenderingError
from aslip.library import GaitLibrary, TransitionTable
from aslip.robot.model import load_model
from aslip.robot.opengl import make_renderer
from tests.helpers import MakeEnv

_UNCOMPILED = Path(__file__).parent / "rom" / "test_full_stride.py"

# no test gains from more threads
torch.set_num_threads(1)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    """Use one thread of PyTorch, as their number changes the last bits of results."""
    torch.set_num_threads(1)


# background jobs of a shell ignore Ctrl-C, and so would processes that tests interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail if tests were skipped although all tools are installed, as in `.ci/run`."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("ASLIP_FAIL_ON_SKIP") and reporter and reporter.stats.get("skipped"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the second process begin with a file that needs nothing of Numba.

    Otherwise both would compile the same functions in a fresh checkout.
    """
    first = items[0].path if items else None
    order = {first: 0, _UNCOMPILED: 1}
    items.sort(key=lambda item: order.get(item.path, 2))


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Seed the global generator, which draws TorchRL's random actions."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def library() -> GaitLibrary:
    """The library that ships with the package."""
    return GaitLibrary.load()


@pytest.fixture(scope="session")
def model() -> mujoco.MjModel:
    """The robot's model, which no test changes."""
    return load_model()


@pytest.fixture(scope="session")
def pictures() -> None:
    """Skip a test that draws where no OpenGL works."""
    try:
        make_renderer(load_model(visual=False), 8, 8).close()
    except RenderingError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def walking() -> GaitLibrary:
    """Small library with stop and start."""
    from tests.library.standing import standing_library

    return standing_library()


@pytest.fixture(scope="session")
def table(walking: GaitLibrary) -> TransitionTable:
    """Stop and start of the small library."""
    assert walking.transitions is not None
    return walking.transitions


@pytest.fixture
def make(library: GaitLibrary) -> MakeEnv:
    """`aslip.make_env` with the loaded library and one physics thread."""

    def make(backend: str = "batch", **settings: Any) -> StackEnv:
        defaults: dict[str, Any] = {"num_threads": 1, "seed": 0}
        if isinstance(settings.get("stack", "straight"), str):
            defaults["library"] = library
        return aslip.make_env(backend, **{**defaults, **settings})  # pyright: ignore

    return make
