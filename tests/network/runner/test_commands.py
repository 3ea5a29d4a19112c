"""Schedules, keys of a pseudo terminal, and datagrams on loopback."""

import json
import math
import os
import socket
import termios

import numpy as np
import pytest

from aslip.errors import ConfigurationError, NetworkError
from aslip.library import Schedule
from aslip.network.runner.commands import Datagrams, Keyboard, Scheduled, parse_request, press
from aslip.network.runner.supervisor import Request


def test_a_schedule_runs_over_the_time_of_the_walk_and_stops() -> None:
    source = Scheduled(Schedule.parse("0:0.2,1:0.8"), duration=2.0)
    requests = [source.request(9.0, walking) for walking in (-math.inf, 0.0, 1.0, 1.99, 2.0)]
    assert [request.forward for request in requests] == [0.2, 0.2, 0.8, 0.8, 0.8]
    assert [request.stop for request in requests] == [False] * 4 + [True]


def test_a_schedule_in_any_direction() -> None:
    source = Scheduled(Schedule.parse("0.5 0.1 -0.2"))
    assert source.sideways
    assert not Scheduled(Schedule.parse("0.5 0 -0.2")).sideways
    assert source.request(0.0, 1e6) == Request(0.5, 0.1, -0.2)
    assert not source.stands
    resting = Scheduled(Schedule.parse("0:0.5 0 0,2:stand"))
    assert resting.stands
    assert resting.request(0.0, 1.0) == Request(0.5)
    assert resting.request(0.0, 2.0) == Request(stand=True)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("", Request(walk=False)),
        ("\n", Request()),
        ("\rwws", Request(forward=0.1)),
        ("adda", Request(walk=False)),
        ("aq", Request(yaw_rate=0.1, sideways=0.1, walk=False)),
        ("\nwq ", Request()),
        ("wc", Request(forward=0.1, walk=False, stand=True)),
        ("cc", Request(walk=False)),
        ("w.", Request(forward=0.1, walk=False, stop=True)),
        ("x", Request(walk=False, damp="operator: key x")),
        ("ü1~", Request(walk=False)),
    ],
)
def test_keys_change_the_request(keys: str, expected: Request) -> None:
    request = Request(walk=False)
    for key in keys:
        request = press(request, key)
    assert request == expected


def test_the_keyboard_reads_without_waiting_and_restores_the_terminal() -> None:
    ours, theirs = os.openpty()
    try:
        before = termios.tcgetattr(theirs)
        with pytest.raises(RuntimeError), Keyboard(theirs) as keyboard:
            assert not termios.tcgetattr(theirs)[3] & (termios.ICANON | termios.ECHO)
            assert keyboard.request(0.0, 0.0) == Request(walk=False)
            os.write(ours, b"\nww")
            assert keyboard.request(0.0, 0.0) == Request(forward=0.2)
            raise RuntimeError
        assert termios.tcgetattr(theirs) == before
    finally:
        os.close(ours)
        os.close(theirs)


def test_a_closed_terminal_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = os.openpty()
    try:
        with Keyboard(theirs) as keyboard:
            os.write(ours, b"w")
            monkeypatch.setattr(os, "read", lambda *_: b"")
            with pytest.raises(OSError, match="the terminal is closed"):
                keyboard.request(0.0, 0.0)
    finally:
        os.close(ours)
        os.close(theirs)


def test_the_keyboard_needs_a_terminal() -> None:
    read, write = os.pipe()
    with pytest.raises(ConfigurationError, match="--command"):
        Keyboard(read)
    for end in (read, write):
        os.close(end)


def test_the_newest_datagram_counts_until_it_is_old() -> None:
    said: list[str] = []
    with (
        Datagrams(0, said.append) as source,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):
        assert source.request(0.0, 0.0) == Request(walk=False)
        good = '{"forward": 0.5, "yaw_rate": 0.1}'
        for text in ('{"forward": 0.3}', good, '{"forward": "fast"}'):
            sender.sendto(text.encode(), ("127.0.0.1", source.port))
        assert source.request(5.0, 0.0) == Request(0.5, yaw_rate=0.1)
        assert source.request(5.9, 0.0) == Request(0.5, yaw_rate=0.1)
        assert source.request(6.1, 0.0) == Request()
        assert said == ["command refused: forward must be float, got 'fast'"]
        for _ in range(200):
            sender.sendto(b'{"a": 1}', ("127.0.0.1", source.port))
            source.request(6.1, 0.0)
    assert len(said) == 1


def test_a_stop_or_damping_counts_before_a_newer_datagram() -> None:
    with Datagrams(0) as source, socket.socket(type=socket.SOCK_DGRAM) as sender:
        for sent in ('{"damp": "red button"}', '{"stop": true}', '{"forward": 0.5}'):
            sender.sendto(sent.encode(), ("127.0.0.1", source.port))
        expected = Request(0.5, stop=True, damp="operator: red button")
        assert source.request(0.0, 0.0) == expected


def test_stones_come_once_with_the_first_datagram_that_has_them() -> None:
    """A triangle beside a square; heights are the mean of the corners'."""
    square = [[0, 0, 0.1], [1, 0, 0.1], [1, 1, 0.3], [0, 1, 0.3]]
    triangle = [[0, 2, -0.1], [0, 3, -0.1], [1, 2, -0.1]]  # clockwise
    with Datagrams(0) as source, socket.socket(type=socket.SOCK_DGRAM) as sender:
        for entries in ({"stones": [square, triangle]}, {"forward": 0.5}):
            sender.sendto(json.dumps(entries).encode(), ("127.0.0.1", source.port))
        first, later = source.request(0.0, 0.0), source.request(0.1, 0.0)
    assert (first.forward, later.forward, later.stones) == (0.5, 0.5, None)
    assert first.stones is not None
    np.testing.assert_allclose(first.stones[0], [[*c[:2], 0.2] for c in square], atol=1e-12)
    last = [[1, 2, -0.1], [0, 3, -0.1], [0, 2, -0.1], [0, 2, -0.1]]
    np.testing.assert_allclose(first.stones[1], last, atol=1e-12)
    floor = parse_request(b'{"stones": []}').stones
    assert floor is not None and np.isnan(floor).all()


def test_a_port_in_use_for_commands_is_named() -> None:
    with Datagrams(0) as first, pytest.raises(NetworkError, match=f"{first.port}.*--listen"):
        Datagrams(first.port)


def test_what_is_shown_of_a_datagram_is_short_and_printable() -> None:
    request = parse_request(b'{"damp": "\\u001b[2J\\n\\ud800' + 1000 * b"x" + b'"}')
    assert request.damp == "?[2J??" + 74 * "x"
    for text in ('{"forward": "X"}', '{"X": 1}', '"X"', "X", '{"walk": {"X": 1}}'):
        with pytest.raises(ConfigurationError) as refused:
            parse_request(text.replace("X", 4000 * "1").encode())
        assert len(str(refused.value)) < 250


WRONG = {
    "[1]": "a JSON object",
    "{": "not JSON",
    "\xff": "not JSON",
    3000 * "[": "not JSON",
    '{"speed": 1}': "no entry 'speed'",
    '{"forward": NaN}': "forward must be at most 100, got nan",
    '{"yaw_rate": 1' + 500 * "0" + "}": "yaw_rate must be at most 100",
    '{"forward": true}': "forward must be float",
    '{"walk": 1}': "walk must be bool",
    '{"damp": true}': "damp must be str",
    '{"stones": 1}': "stones must be list",
    '{"stones": [[1, 2, 3]]}': "stones must be lists of corners",
    '{"stones": [[[1, 2], [2, 3], [4, 5]]]}': "stones must be lists of corners",
    '{"stones": [[[1, 2, "x"]]]}': "stones must be lists of corners",
    '{"stones": [[[0, 0, 0], [1, 0, 0], [1, NaN, 0]]]}': "stones must be within 100 m",
    '{"stones": [[[0, 0, 0], [1, 0, 0]]]}': "three or more corners",
    '{"stones": [[[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 2, 0]]]}': "must be convex",
    '{"stones": [' + 64 * "0, " + "0]}": "at most 64, got 65",
}


def test_wrong_requests_are_refused() -> None:
    for text, message in WRONG.items():
        with pytest.raises(ConfigurationError, match=message):
            parse_request(text.encode("latin-1"))
