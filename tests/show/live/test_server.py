"""Invalid addresses, unusual requests, and a missing viser are reported."""

import ast
import socket
import urllib.request
from pathlib import Path

import pytest

import aslip
from aslip.errors import ConfigurationError
from aslip.show.live.server import page_url, start_server


def test_taken_port_is_named():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=rf"port {port} .*in use"):
            start_server("127.0.0.1", port)


@pytest.fixture(scope="module")
def served():
    server = start_server("127.0.0.1", 0)
    yield server
    server.stop()


@pytest.mark.parametrize("port", [-1, 65536])
def test_port_out_of_range_is_an_error(port):
    with pytest.raises(ConfigurationError, match=str(port)):
        start_server("127.0.0.1", port)


@pytest.mark.parametrize("host", ["192.0.2.1", "no such host", ""])
def test_host_must_be_this_machine(host, monkeypatch):
    monkeypatch.setattr("viser.ViserServer", lambda **_: pytest.fail("viser would hang"))
    with pytest.raises(ConfigurationError, match=r"host|listen"):
        start_server(host, 0)


def test_page_answers_at_its_url_and_frees_its_port(capsys):
    server = start_server("127.0.0.1", 0, "Cassie, twin")
    port = server.get_port()
    assert capsys.readouterr().out == ""
    try:
        assert page_url(server) == f"http://127.0.0.1:{port}"
        with urllib.request.urlopen(page_url(server)) as answer:
            head = answer.read(6000)
            assert b"<html" in head
            assert b"<title>Cassie, twin</title>" in head
            assert head.count(b'rel="icon"') == 1
            assert b"labels = [], " in head  # nothing to steer
            # another site cannot show it, either
            assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'self'"
    finally:
        server.stop()
    again = start_server("127.0.0.1", port)
    assert again.get_port() == port
    again.stop()


@pytest.mark.parametrize(
    ("origin", "host", "own"),
    [
        (None, "127.0.0.1:PORT", True),  # no browser
        ("http://127.0.0.1:PORT", "127.0.0.1:PORT", True),
        ("http://localhost:9000", "localhost:9000", True),  # a tunnel of ssh
        ("http://[::1]:PORT", "[::1]:PORT", True),
        (f"http://{socket.gethostname()}:PORT", f"{socket.gethostname().upper()}:PORT", True),
        ("http://a.example", "127.0.0.1:PORT", False),
        ("http://127.0.0.1:1", "127.0.0.1:PORT", False),
        ("http://a.example:PORT", "a.example:PORT", False),  # its name points to this machine
        ("", "", False),
        ("http://[", "[", False),
    ],
)
def test_other_web_sites_cannot_reach_the_page(served, origin, host, own):
    port = str(served.get_port())
    with socket.create_connection(("127.0.0.1", int(port))) as visitor:
        lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
        lines += [] if origin is None else [f"Origin: {origin}"]
        visitor.sendall("\r\n".join([*lines, "", ""]).replace("PORT", port).encode())
        status = visitor.recv(1000).split()[1]
    assert status == (b"101" if own else b"403")


@pytest.mark.parametrize(
    ("host", "shown"), [("0.0.0.0", "localhost"), ("::", "localhost"), ("::1", "[::1]")]
)
def test_url_is_valid_in_a_browser(host, shown):
    class Server:
        get_host = staticmethod(lambda: host)
        get_port = staticmethod(lambda: 8080)

    assert page_url(Server()) == f"http://{shown}:8080"  # pyright: ignore


def test_only_the_live_page_imports_viser():
    package = Path(aslip.__file__).parent
    users = {
        path.relative_to(package).parts[:2]
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.Import) and any(a.name.startswith("viser") for a in node.names))
        or (isinstance(node, ast.ImportFrom) and (node.module or "").startswith("viser"))
    }
    assert users == {("show", "live")}
