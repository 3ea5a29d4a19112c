"""A visitor of the page without a browser: raw messages to the server and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

from aslip.live import LivePage

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
    """One connection, as a browser's."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection

    def send(self, **message: Any) -> None:
        self._connection.send(msgspec.msgpack.encode(message))

    def update(self, control: Any, **updates: Any) -> None:
        self.send(type="GuiUpdateMessage", uuid=control._impl.uuid, updates=updates)

    def messages(self, kind: str, until: Any = None) -> list[dict]:
        """What has come of a kind, up to the first that satisfies a condition, or one of them.

        Raises:
            TimeoutError: there is none for half a minute.
        """
        found = []
        while True:
            raw = self._connection.recv(timeout=30)
            size = int.from_bytes(raw[8:16], "little")
            content = msgspec.msgpack.decode(zstandard.decompress(raw[16 : 16 + size]))
            for message in content["messages"]:
                if message["type"] == kind:
                    found.append(message)
                    if until is None or until(message):
                        return found


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
