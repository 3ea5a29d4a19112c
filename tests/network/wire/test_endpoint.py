"""Sockets on loopback: newest datagram, peers, ports in use, addresses of other machines."""

import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from aslip.errors import ConfigurationError, NetworkError
from aslip.network.wire import LOOPBACK, PD_IN, STATE_OUT, Address, Endpoint, Link
from tests.network.twin.sockets import ANY_PORT, robot_socket, socket_to


@pytest.fixture
def robot() -> Iterator[Endpoint]:
    with robot_socket() as endpoint:
        yield endpoint


@pytest.fixture
def client(robot: Endpoint) -> Iterator[Endpoint]:
    with socket_to(robot.local) as endpoint:
        yield endpoint


def _command(number: float) -> np.ndarray:
    record = PD_IN.zeros()
    record["telemetry"][0] = number
    return record


def _received(endpoint: Endpoint) -> float | None:
    """First number of the telemetry of the newest packet."""
    record = endpoint.receive() if endpoint.wait(1.0) else None
    return None if record is None else float(record["telemetry"][0])


def test_the_newest_of_several_datagrams_counts(robot: Endpoint, client: Endpoint) -> None:
    for number in range(5):
        client.send(_command(number))
    assert _received(robot) == 4.0
    assert (robot.link.counters.accepted, robot.link.counters.superseded) == (5, 4)
    assert robot.receive() is None


def test_all_queued_datagrams_arrive_in_order(robot: Endpoint, client: Endpoint) -> None:
    for number in range(4):
        client.send(_command(number))
        if number == 1:
            client.link.datagram(_command(-1.0))  # lost
    assert robot.wait(1.0)
    arrivals = robot.receive_all()
    assert [float(arrival.record["telemetry"][0]) for arrival in arrivals] == [0, 1, 2, 3]
    assert [arrival.step for arrival in arrivals] == [0, 1, 2, 1]
    assert robot.link.counters.superseded == 0
    assert robot.receive_all() == []


def test_a_robot_answers_the_first_sender(robot: Endpoint, client: Endpoint) -> None:
    client.send(_command(1.0))
    _received(robot)
    assert robot.peer == client.local
    robot.send(STATE_OUT.zeros())
    assert client.wait(1.0)
    assert client.receive() is not None


def test_a_second_client_is_not_heard(robot: Endpoint, client: Endpoint) -> None:
    client.send(_command(1.0))
    assert _received(robot) == 1.0
    with socket_to(robot.local) as second:
        second.send(_command(2.0))
        assert _received(robot) is None
    assert robot.peer == client.local
    assert robot.link.counters.foreign == 1


def test_a_new_client_takes_the_place_of_a_silent_one(robot: Endpoint, client: Endpoint) -> None:
    for _ in range(3):
        client.send(_command(1.0))
    _received(robot)
    time.sleep(0.12)
    with socket_to(robot.local) as second:
        second.send(_command(2.0))
        assert _received(robot) == 2.0
        assert robot.peer == second.local
    assert robot.link.counters.restarts == 1


def test_a_client_that_restarts_at_its_old_address_is_heard_after_a_silence(
    robot: Endpoint,
) -> None:
    """Its numbers begin again, below those of its predecessor."""
    with socket_to(robot.local) as client:
        for _ in range(5):
            client.send(_command(1.0))
        assert _received(robot) == 1.0
        address = client.local
    with Endpoint(Link(PD_IN, STATE_OUT, refuse_not_finite=False), address, robot.local) as again:
        again.send(_command(2.0))
        assert _received(robot) is None
        time.sleep(0.12)
        again.send(_command(3.0))
        assert _received(robot) == 3.0
    assert (robot.link.counters.late, robot.link.counters.restarts) == (1, 1)


def test_datagrams_of_the_wrong_size_do_not_set_the_peer(robot: Endpoint) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for size in (0, 1, 477, 479, 2000):
            other.sendto(bytes(size), robot.local)
            assert robot.wait(1.0)
            assert robot.receive() is None
    assert robot.peer is None
    assert robot.link.counters.wrong_size == 5


@pytest.mark.parametrize("content", [b"", bytes(700), "nan", "the same nan"])
def test_a_client_that_sends_only_invalid_datagrams_is_silent(
    robot: Endpoint, client: Endpoint, content: bytes | str
) -> None:
    """Another one takes its place, but not with an invalid datagram."""

    def invalid(sender: Endpoint) -> bytes:
        return content if isinstance(content, bytes) else sender.link.datagram(_command(np.nan))

    client.send(_command(1.0))
    assert _received(robot) == 1.0
    once = invalid(client)
    with socket_to(robot.local) as second:
        for _ in range(6):
            time.sleep(0.025)
            client._socket.sendto(
                once if content == "the same nan" else invalid(client), robot.local
            )
            assert _received(robot) is None
        second._socket.sendto(invalid(second), robot.local)
        assert _received(robot) is None
        assert robot.peer == client.local
        second.send(_command(2.0))
        assert _received(robot) == 2.0
        assert robot.peer == second.local


def test_a_request_is_repeated_until_it_is_answered(robot: Endpoint, client: Endpoint) -> None:
    with pytest.raises(NetworkError, match=f"no answer from {robot.local} within 0.1 s"):
        client.request(_command(1.0), timeout=0.1, repeat=0.01)
    assert _received(robot) == 1.0
    assert robot.link.counters.repeated >= 3
    assert robot.link.counters.accepted == 1


def test_sending_without_a_peer_is_an_error(robot: Endpoint) -> None:
    with pytest.raises(NetworkError, match="no peer"):
        robot.send(STATE_OUT.zeros())


def test_a_port_in_use_is_named(robot: Endpoint) -> None:
    with pytest.raises(NetworkError, match=f"another program listens at {robot.local}"):
        Endpoint(robot.link, robot.local)


def test_an_address_of_another_machine_cannot_be_listened_at() -> None:
    """192.0.2.0/24 is reserved for documentation (RFC 5737)."""
    link = Link(STATE_OUT, PD_IN, refuse_not_finite=True)
    with pytest.raises(NetworkError, match=r"cannot listen at 192\.0\.2\.1:25000"):
        Endpoint(link, Address("192.0.2.1", 25000), beyond_loopback=True)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1"])
def test_addresses_beyond_loopback_need_permission(host: str) -> None:
    link = Link(STATE_OUT, PD_IN, refuse_not_finite=True)
    with pytest.raises(ConfigurationError, match="beyond this machine"):
        Endpoint(link, Address(host, 0))
    with pytest.raises(ConfigurationError, match="beyond this machine"):
        Endpoint(link, ANY_PORT, Address(host, 25000))
    if host == "0.0.0.0":
        Endpoint(link, Address(host, 0), beyond_loopback=True).close()


@pytest.mark.parametrize(("host", "port"), [("robot", 25000), ("::1", 25000), (LOOPBACK, 70000)])
def test_wrong_addresses_are_refused(host: str, port: int) -> None:
    with pytest.raises(ConfigurationError, match=r"IPv4 address|70000"):
        Endpoint(Link(STATE_OUT, PD_IN, refuse_not_finite=True), Address(host, port))
