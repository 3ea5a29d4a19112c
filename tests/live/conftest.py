"""Servers and pages that are gone after the test, and what is put on them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import torch
from tensordict.nn import TensorDictModule

pytest.importorskip("viser", reason="the extra 'live' is not installed")

import viser

from aslip.library import GaitLibrary
from aslip.live import LivePage
from aslip.walker import Walker

# for a condition to come true on a busy machine [s]
PATIENCE = 60.0


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def open_page(library: GaitLibrary) -> Iterator[Callable[..., LivePage]]:
    """Makes pages of a walker that stands, on any free port."""
    pages: list[LivePage] = []

    def open_page(*policies, speed=0.0, **settings) -> LivePage:
        walker = Walker(library=library, speed=speed)
        pages.append(LivePage(walker, *policies, **{"port": 0, **settings}))
        return pages[-1]

    yield open_page
    for page in pages:
        page.stop()


def limp() -> TensorDictModule:
    """A policy that leaves the robot to the reference, on which it falls."""
    return TensorDictModule(
        lambda observation: torch.zeros(*observation.shape[:-1], 10),
        in_keys=["observation"],
        out_keys=["action"],
    )


@contextmanager
def served(page: LivePage) -> Iterator[None]:
    """Serve a page meanwhile; what `serve` raises is raised here."""
    raised: list[BaseException] = []

    def serve() -> None:
        try:
            page.serve()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        page.stop()
        thread.join(PATIENCE)
    assert not thread.is_alive()
    if raised:
        raise raised[0]


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition is true; fail if it does not become so."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "still not so after a minute"
        time.sleep(0.01)
