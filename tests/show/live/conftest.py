"""Servers and pages that are closed after the test."""

from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("viser", reason="the extra 'live' is not installed")

import viser

from aslip.library import GaitLibrary
from aslip.show.live import LivePage
from aslip.walking import Walker


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    server.scene.add_frame("/world", show_axes=False)
    yield server
    server.stop()


@pytest.fixture
def open_page(library: GaitLibrary) -> Iterator[Callable[..., LivePage]]:
    """Function that opens pages of a standing walker on a free port."""
    pages: list[LivePage] = []

    def open_page(*policies, speed=0.0, **settings) -> LivePage:
        walker = Walker("straight", library=library, speed=speed, seed=0)
        pages.append(LivePage(walker, *policies, **{"port": 0, **settings}))
        return pages[-1]

    yield open_page
    for page in pages:
        page.stop()
