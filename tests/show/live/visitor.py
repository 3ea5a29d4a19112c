"""Visitor of the page without a browser: raw messages to and from the server."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

from aslip.show.live import LivePage

_CAMERA: dict[str, Any] = {
    "wxyz": [1, 0, 0, 0],
    "position": [2, 0, 1],
    "fov": 1,
    "near": 0.1,
    "far": 100,
    "image_height": 480,
    "image_width": 640,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}


class Visitor:
    """Connection like that of a browser."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._received: list[dict] = []

    def send(self, **message: Any) -> None:
        self._connection.send(msgspec.msgpack.encode(message))

    def update(self, control: Any, **updates: Any) -> None:
        self.send(type="GuiUpdateMessage", uuid=control._impl.uuid, updates=updates)

    def messages(self, kind: str, until: Callable[[dict], bool]) -> list[dict]:
        """All messages of a kind, up to the first that satisfies a condition.

        Raises:
            TimeoutError: no message satisfies it for half a minute.
        """
        found: list[dict] = []
        for message in self._all():
            if message["type"] == kind:
                found.append(message)
                if until(message):
                    return found
        raise AssertionError("the connection was closed")

    def _all(self) -> Iterator[dict]:
        """Iterate over all messages, and wait for more."""
        for i in itertools.count():
            while i >= len(self._received):
                raw = self._connection.recv(timeout=30)
                size = int.from_bytes(raw[8:16], "little")
                content = msgspec.msgpack.decode(zstandard.decompress(raw[16 : 16 + size]))
                self._received += content["messages"]
            yield self._received[i]


@contextmanager
def visit(page: LivePage) -> Iterator[Visitor]:
    """Open the page."""
    url = page.url.replace("http", "ws")
    protocol: Any = f"viser-v{viser.__version__}"
    with connect(url, subprotocols=[protocol], max_size=None, compression=None) as connection:
        visitor = Visitor(connection)
        # the server takes no clicks before it knows the camera
        visitor.send(type="ViewerCameraMessage", **_CAMERA)
        yield visitor
