"""Fixtures of all tests: the shipped gait library and small environments."""

from __future__ import annotations

import ctypes.util
import os
import signal
from typing import Any

import pytest
import torch

# pictures are tested in software where there is no display; MuJoCo asks once, at its import
if "DISPLAY" not in os.environ and ctypes.util.find_library("OSMesa"):
    os.environ.setdefault("MUJOCO_GL", "osmesa")

import aslip
from aslip.envs import StackEnv
from aslip.library import GaitLibrary
from tests.helpers import MakeEnv

# the machine is shared, and no test gains from more
torch.set_num_threads(1)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    """PyTorch's threads, which change the last bits, whatever the tests before have set."""
    torch.set_num_threads(1)


# the background jobs of a shell ignore Ctrl-C, and so would what tests start and interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run that skipped tests where all tools are installed, as `.ci/run` says they are."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("ASLIP_FAIL_ON_SKIP") and reporter and reporter.stats.get("skipped"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Seed TorchRL's random actions, which come from the global generator."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def library() -> GaitLibrary:
    """The library that ships with the package."""
    return GaitLibrary.load()


@pytest.fixture
def make(library: GaitLibrary) -> MakeEnv:
    """`aslip.make_env` with the library at hand and one physics thread."""

    def make(backend: str = "batch", **settings: Any) -> StackEnv:
        defaults: dict[str, Any] = {"num_threads": 1}
        if isinstance(settings.get("stack", "aslip"), str):
            defaults["library"] = library
        return aslip.make_env(backend, **{**defaults, **settings})  # pyright: ignore

    return make
