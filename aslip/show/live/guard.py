"""A guard between the visitors of a page and its server: only valid values of controls pass.

Whatever a page sends, viser keeps and sends on to every later visitor. One value that cannot be
encoded would close the page for all of them, and a page can set any attribute of a control, ask
for a public address of the server, or have messages kept that nobody reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import viser
from viser import _messages as messages

Check = Callable[[object], Any]
"""Map what a visitor sent to a valid value; raise ValueError if there is none."""


def number_within(low: float, high: float) -> Check:
    """Check for numbers, clamped to a range; NaN and other types are refused."""

    def check(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise ValueError(f"not a number: {value!r:.40}")
        return min(max(value, low), high)

    return check


def one_of(options: Sequence[str]) -> Check:
    """Check for one of some names."""

    def check(value: object) -> str:
        if not isinstance(value, str) or value not in options:
            raise ValueError(f"not one of {options}: {value!r:.40}")
        return value

    return check


def switch(value: object) -> bool:
    """Check for True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"neither true nor false: {value!r:.40}")
    return value


def guard(server: viser.ViserServer, checks: Mapping[str, Check]) -> None:
    """Let nothing pass from visitors to a server but valid values of its controls.

    Values out of range are clamped; everything else that is invalid is dropped. What concerns one
    visitor alone, such as the place of a camera, is not kept by the server and not touched here.

    Args:
        server: of the page.
        checks: by uuid of the control.
    """
    # viser has no public hook ahead of its own handlers
    connections, accept = server._websock_server, server.gui._handle_gui_updates

    async def pass_valid(client: Any, message: messages.GuiUpdateMessage) -> None:
        try:
            uuid, value = message.uuid, message.updates["value"]
            message.updates = {"value": checks[uuid](value)}
        except (KeyError, TypeError, ValueError):
            return
        await accept(client, message)

    for kind in tuple(connections._incoming_handlers):
        connections.unregister_handler(kind)
    connections.register_handler(messages.GuiUpdateMessage, pass_valid)
