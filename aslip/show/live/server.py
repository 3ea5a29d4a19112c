"""A viser server at the address that was asked for, or none."""

from __future__ import annotations

import errno
import logging
import socket

import viser

from aslip.errors import ConfigurationError

_PORTS = 65536


def start_server(host: str, port: int) -> viser.ViserServer:
    """Start a server.

    viser would take the next free port if one is taken, and look for one for ever on a host that it
    cannot have; here both are errors.

    Args:
        host: name or address of this machine on which to listen.
        port: to listen on; 0 for any that is free.

    Raises:
        ConfigurationError: the host is not this machine's, or the port is taken or not allowed.
    """
    _check_free(host, port)
    logging.getLogger("websockets.server").addFilter(_without_tracebacks)
    server = viser.ViserServer(host=host, port=port, verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise ConfigurationError(
            f"viser listens on port {server.get_port()} and not on {port}, which was taken in the"
            " meantime, or the environment variable _VISER_PORT_OVERRIDE is set"
        )
    return server


def page_url(server: viser.ViserServer) -> str:
    """Where a browser on this machine finds a server."""
    host = server.get_host()
    if host in ("0.0.0.0", "::"):
        host = "localhost"
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def _without_tracebacks(record: logging.LogRecord) -> bool:
    """Drop reports of requests that are not a browser's, such as HEAD; shorten others to a line."""
    if record.exc_info and record.exc_info[1] is not None:
        record.msg, record.args = f"{record.getMessage()}: {record.exc_info[1]!r}", ()
        record.exc_info = record.exc_text = None
    return not record.msg.startswith("opening handshake failed")


def _check_free(host: str, port: int) -> None:
    if not 0 <= port < _PORTS:
        raise ConfigurationError(f"a port is a number from 0 to {_PORTS - 1}, got {port!r}")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise ConfigurationError(f"there is no host {host!r}: {error}") from error
    for family, kind, protocol, _, address in found:
        with socket.socket(family, kind, protocol) as probe:
            # as the server will have it; a port whose last owner has just gone is free
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(address)
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    raise ConfigurationError(
                        f"port {port} on {host} is taken; choose another, or 0 for any that is free"
                    ) from error
                raise ConfigurationError(
                    f"cannot listen on port {port} of {host!r}: {error.strerror}"
                ) from error
