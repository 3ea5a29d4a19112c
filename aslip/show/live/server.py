"""Server of the page, which listens at the given address only and accepts only valid values.

Web sites that are open in the same browser can reach it, too, so it accepts no browser's request
from another origin than its own.

viser keeps all messages of browsers and sends them to every later visitor. A value that cannot be
encoded would close the page for all of them. A browser could also set any attribute of a control,
request a public address of the server, or fill its memory. So the server accepts only valid values
of controls.
"""

from __future__ import annotations

import gzip
import html
import io
import ipaddress
import json
import math
import re
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
from viser import _messages as messages
from websockets.asyncio import server as websockets
from websockets.http11 import Request, Response

from aslip.errors import ConfigurationError
from aslip.show.palette import LEFT, MODEL, RIGHT

_HEAD = Path(__file__).with_name("head.html")
_ICON, _TITLE = re.compile(r'<link\s+rel="icon".*?>', re.DOTALL), "<title>Viser</title>"


def start_server(
    host: str, port: int, title: str = "", steering: Mapping[str, object] | None = None
) -> viser.ViserServer:
    """Start a server, without viser's lines in the terminal.

    A taken port and a host that is not this machine are errors; viser itself would choose another
    port, and search forever on such a host.

    Args:
        host: name or address of this machine to listen on.
        port: port to listen on; 0 for any free one.
        title: title of the page.
        steering: values of `steering_head`, for pages on which one steers.

    Raises:
        ConfigurationError: the host is not this machine, or the port is taken or not allowed.
    """
    _check_free(host, port)
    with _own_page(host, _head(title, steering or {})), redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise ConfigurationError(
            f"viser listens on port {server.get_port()} and not on {port}, which was taken in the"
            " meantime, or the environment variable _VISER_PORT_OVERRIDE is set"
        )
    return server


def page_url(server: viser.ViserServer) -> str:
    """Address of a server for a browser on this machine."""
    host = server.get_host()
    if host in ("0.0.0.0", "::"):
        host = "localhost"
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def note(text: str) -> str:
    """Small grey text for the panel, as HTML."""
    return f"<div class='aslip-note'>{html.escape(text)}</div>"


def _head(title: str, steering: Mapping[str, object]) -> str:
    """Head of a page: title, icon, styles and script."""
    head = _HEAD.read_text(encoding="utf-8").replace("TITLE", html.escape(title))
    for name, color in (("LEFT", LEFT), ("RIGHT", RIGHT), ("MODEL", MODEL)):
        head = head.replace(f"'{name}'", f"'{color.replace('#', '%23')}'")
    for name in ("LABELS", "FIELD", "BUTTONS"):
        head = head.replace(f"= {name}", f"= {json.dumps(steering.get(name, []))}")
    return head


def _add_head(response: Response, head: str) -> None:
    """Put a head into viser's page, in the place of its title and its icon."""
    zipped = response.headers["Content-Encoding"] == "gzip"
    page = (gzip.decompress(response.body) if zipped else response.body).decode()
    body = _ICON.sub("", page, count=1).replace(_TITLE, head, 1).encode()
    response.body = gzip.compress(body, 1) if zipped else body
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


@contextmanager
def _own_page(host: str, head: str) -> Iterator[None]:
    """Give servers that start meanwhile a head, and let them refuse requests of other origins.

    viser has no option for either.
    """
    serve = websockets.serve

    def guarded(*args: Any, process_request: Any, **settings: Any) -> Any:
        def process(connection: Any, request: Request) -> Response | None:
            if not is_own_origin(request, host):
                refusal = "This page takes no requests of other web sites.\n"
                return connection.respond(HTTPStatus.FORBIDDEN, refusal)
            response = process_request(connection, request)
            if response is not None:
                if response.headers.get("Content-Type", "").startswith("text/html"):
                    _add_head(response, head)
                # no other site may show the page under its own buttons
                response.headers["Content-Security-Policy"] = "frame-ancestors 'self'"
            return response

        return serve(*args, process_request=process, **settings)

    websockets.serve = guarded
    try:
        yield
    finally:
        websockets.serve = serve


def is_own_origin(request: Request, host: str) -> bool:
    """Check that a request comes from the page, or from a program that is no browser.

    Browsers always name the origin of a WebSocket, other programs need not: any of them on this
    machine could name a false one. The page's own address must be a number, localhost or this
    machine's name, since a web site can let its own name point to this machine.

    Args:
        request: request with the headers `Origin` and `Host`.
        host: name or address at which the server listens.
    """
    try:
        origin, own = request.headers.get("Origin"), request.headers.get("Host", "")
        if origin is None:
            return True
        name = urlsplit(f"//{own}").hostname or ""
        machine = socket.gethostname().lower()
        if name not in ("localhost", host.lower(), machine, f"{machine}.local"):
            ipaddress.ip_address(name)
        return urlsplit(origin).netloc.lower() == own.lower()
    except (LookupError, ValueError):  # a header twice, no address
        return False


def _check_free(host: str, port: int) -> None:
    if not 0 <= port < 2**16:
        raise ConfigurationError(f"port must be a number from 0 to 65535, got {port!r}")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, *_ in found:
            socket.create_server((host, port), family=family).close()
    except (OSError, UnicodeError) as error:
        raise ConfigurationError(f"cannot listen on port {port} of {host!r}: {error}") from error


Check = Callable[[object], Any]
"""Function from a visitor's value to a valid one; raises ValueError for invalid ones."""


def number_within(low: float, high: float) -> Check:
    """Check for numbers, clamped to a range; NaN and other types are refused."""

    def check(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise ValueError(f"not a number: {value!r:.40}")
        return min(max(value, low), high)

    return check


def one_of(options: Sequence[str]) -> Check:
    """Check for one of several names."""

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


def guard(
    server: viser.ViserServer,
    checks: Mapping[str, Check],
    keys: Mapping[str, Callable[[], object]] | None = None,
    touch: Callable[[Any, np.ndarray], object] | None = None,
) -> None:
    """Accept only valid values of controls, known keys, and clicks and drags of visitors.

    Values out of range are clamped; other invalid messages are dropped. Messages on a single
    visitor's state, such as the camera, pass, because the server does not keep them.

    Args:
        server: server of the page.
        checks: uuid of a control -> check of its value.
        keys: uuid of a command of viser's palette -> function that is called at each press of its
            key, in their order.
        touch: function that is called with clicks on nodes of the scene and parts of their drags,
            and the place (3,) of the visitor's camera [m]; it raises ValueError for invalid ones.
    """
    # viser has no public hook before its own handlers
    connections, accept = server._websock_server, server.gui._handle_gui_updates

    async def pass_valid(client: Any, message: messages.GuiUpdateMessage) -> None:
        try:
            uuid, value = message.uuid, message.updates["value"]
            message.updates = {"value": checks[uuid](value)}
        except (KeyError, TypeError, ValueError):
            return
        await accept(client, message)

    async def press(client: Any, message: messages.CommandTriggerMessage) -> None:
        # the uuid may have any type
        if keys and isinstance(message.uuid, str) and message.uuid in keys:
            keys[message.uuid]()

    async def pass_touch(client: Any, message: Any) -> None:
        try:
            if touch is not None:
                touch(message, server.get_clients()[client].camera.position)
        except (AttributeError, KeyError, TypeError, ValueError):
            return

    for kind in tuple(connections._incoming_handlers):
        connections.unregister_handler(kind)
    connections.register_handler(messages.GuiUpdateMessage, pass_valid)
    connections.register_handler(messages.CommandTriggerMessage, press)
    connections.register_handler(messages.SceneNodeClickMessage, pass_touch)
    connections.register_handler(messages.SceneNodeDragMessage, pass_touch)
