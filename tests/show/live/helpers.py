"""Serve a page, and wait for conditions."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from aslip.show.live import LivePage

# for a condition to come true on a busy machine [s]
PATIENCE = 60.0


@contextmanager
def served(page: LivePage) -> Iterator[None]:
    """Serve a page in a thread; errors of `serve` are raised at the end."""
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
    """Wait until a condition is true; fail after a minute."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "still not so after a minute"
        time.sleep(0.01)
