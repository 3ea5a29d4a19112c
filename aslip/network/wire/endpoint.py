"""Non-blocking UDP socket of one side; of several queued datagrams the newest one counts."""

from __future__ import annotations

import errno
import ipaddress
import select
import socket
import time
from typing import Final, NamedTuple

import numpy as np

from aslip.errors import ConfigurationError, NetworkError
from aslip.network.wire.link import Link

LOOPBACK: Final = "127.0.0.1"
"""Address that only programs on this machine can reach."""

SILENCE: Final = 0.1
"""Time without a datagram [s] after which another program may become the peer, or the peer may have
restarted its numbers; equal to the robot's PD time-out."""

# largest number of datagrams per call, so that a flood cannot block the caller
_MOST_QUEUED = 256


class Address(NamedTuple):
    """Address of one side."""

    host: str
    """IPv4 address."""
    port: int

    def __str__(self) -> str:
        """Host and port, joined by a colon."""
        return f"{self.host}:{self.port}"


class Arrival(NamedTuple):
    """Accepted datagram."""

    step: int
    """Difference of its number from the last accepted one; 0 for the first."""
    record: np.ndarray
    """Packet."""


SIMULATOR: Final = Address(LOOPBACK, 25000)
"""Address of the simulated robot."""
CLIENT: Final = Address(LOOPBACK, 25001)
"""Address of its client."""


class Endpoint:
    """Socket that exchanges packets with one peer.

    A client names its peer. A robot's peer is the sender of the first valid datagram; datagrams of
    other programs are dropped until the peer has been silent for 0.1 s. Invalid datagrams, of the
    wrong size or refused numbers, are a silence. If only late datagrams arrive for 0.1 s, the peer
    counts as restarted.

    Args:
        link: kinds of packets, sequence numbers and counters.
        local: address to listen at; port 0 lets the system choose one.
        peer: address of the other side.
        beyond_loopback: allow addresses of other machines. Nothing on the wire is encrypted or
            authenticated: anyone who reaches the port can move the robot.

    Raises:
        ConfigurationError: an address is not IPv4, or is beyond this machine without permission.
        NetworkError: the port is in use, or the address is not this machine's.
    """

    def __init__(
        self,
        link: Link,
        local: Address,
        peer: Address | None = None,
        *,
        beyond_loopback: bool = False,
    ) -> None:
        self.link = link
        """Sequence numbers and counters."""
        for address in (local, *([] if peer is None else [peer])):
            _check(address, beyond_loopback)
        self.peer = peer
        """Address of the other side; None until it is known."""
        self._named = peer is not None
        self._heard = 0.0
        self._last: bytes | None = None
        self._socket = _bound(local)

    @property
    def local(self) -> Address:
        """Address at which this side listens."""
        return Address(*self._socket.getsockname())

    def __enter__(self) -> Endpoint:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for a datagram; return False if none arrives within `timeout` [s]."""
        return bool(select.select([self._socket], [], [], timeout)[0])

    def receive(self) -> np.ndarray | None:
        """Read all queued datagrams without waiting; return the newest packet, or None."""
        arrivals = self.receive_all()
        self.link.counters.superseded += max(len(arrivals) - 1, 0)
        return arrivals[-1].record if arrivals else None

    def receive_all(self) -> list[Arrival]:
        """Read all queued datagrams without waiting; return the accepted ones, oldest first."""
        arrivals: list[Arrival] = []
        for _ in range(_MOST_QUEUED):
            try:
                datagram, sender = self._socket.recvfrom(self.link.size + 1)
            except BlockingIOError:
                break
            record = self._open(datagram, Address(*sender))
            if record is not None:
                arrivals.append(Arrival(self.link.step or 0, record))
        return arrivals

    def send(self, record: np.ndarray) -> None:
        """Send a packet to the peer.

        Raises:
            NetworkError: there is no peer yet, or no route to it.
            ShapeError: the record is of another kind than the link sends.
        """
        if self.peer is None:
            raise NetworkError(f"{self.local} has no peer yet: no client has sent to it")
        self._last = self.link.datagram(record)
        self.resend()

    def resend(self) -> None:
        """Send the last datagram to this peer again, byte for byte; do nothing without one.

        Raises:
            NetworkError: there is no route to the peer.
        """
        if self._last is None or self.peer is None:
            return
        try:
            self._socket.sendto(self._last, self.peer)
        except BlockingIOError:
            pass  # a full buffer is a lost datagram
        except OSError as error:
            raise NetworkError(f"cannot send to {self.peer}: {error.strerror}") from error

    def request(
        self, record: np.ndarray, *, timeout: float = 1.0, repeat: float = 0.02
    ) -> np.ndarray:
        """Send a packet, and repeat the datagram until an answer arrives.

        A robot in lockstep answers repeated datagrams without acting on them twice.

        Args:
            record: packet.
            timeout: longest wait [s].
            repeat: time between repetitions [s].

        Returns:
            Packet of the answer.

        Raises:
            NetworkError: no answer arrives in time, or there is no route to the peer.
        """
        self.send(record)
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if not self.wait(repeat):
                self.resend()
            elif (answer := self.receive()) is not None:
                return answer
        raise NetworkError(
            f"no answer from {self.peer} within {timeout:g} s; check that it is running in"
            " this mode, PD or raw, and that no other client holds it"
        )

    def _open(self, datagram: bytes, sender: Address) -> np.ndarray | None:
        """Check datagram and sender."""
        link, now = self.link, time.monotonic()
        silent = now - self._heard > SILENCE
        if self.peer is not None and self.peer != sender:
            if self._named or not silent or not link.is_valid(datagram):
                link.counters.foreign += 1
                return None
            link.restart()
            self.peer = self._last = None
        repeated = link.counters.repeated
        record = link.open(datagram, silent=silent)
        # a client that got no answer repeats its datagram
        if record is not None or link.counters.repeated > repeated:
            self.peer, self._heard = sender, now
        return record


def _check(address: Address, beyond_loopback: bool) -> None:
    """Check that an address is IPv4 and may be used."""
    try:
        host = ipaddress.IPv4Address(address.host)
    except ValueError:
        raise ConfigurationError(
            f"an IPv4 address such as {LOOPBACK} is needed, got {address.host!r}"
        ) from None
    check_port(address.port)
    if not (host.is_loopback or beyond_loopback):
        raise ConfigurationError(
            f"{address.host} is beyond this machine, and whoever reaches the port can move the"
            f" robot; use {LOOPBACK}, or allow it with beyond_loopback"
        )


def check_port(port: int) -> None:
    """Check that a port exists; 0 stands for any.

    Raises:
        ConfigurationError: it is not between 0 and 65535.
    """
    if not 0 <= port < 2**16:
        raise ConfigurationError(f"a port is between 0 and 65535, got {port}")


def _bound(local: Address) -> socket.socket:
    """Open a non-blocking socket at an address."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setblocking(False)
    try:
        opened.bind(local)
    except OSError as error:
        opened.close()
        if error.errno == errno.EADDRINUSE:
            raise NetworkError(
                f"another program listens at {local}; stop it, or choose another port"
            ) from error
        raise NetworkError(f"cannot listen at {local}: {error.strerror}") from error
    return opened
