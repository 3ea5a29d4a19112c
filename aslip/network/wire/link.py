"""Headers of datagrams: sequence numbers of both directions, and checks of arriving datagrams.

A datagram is a header of two bytes followed by the packet. The header has the sender's sequence
number and the last number that it received, as signed bytes that wrap around.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aslip.network.wire.layout import Packet

HEADER_SIZE: Final = 2
"""Bytes of a header."""


class Header(NamedTuple):
    """First two bytes of a datagram; numbers are -128 to 127."""

    sequence: int
    """Number of this datagram."""
    received: int
    """Last number that the sender received, looped back."""

    def to_bytes(self) -> bytes:
        """Convert to two bytes."""
        return bytes((self.sequence % 256, self.received % 256))

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Header:
        """Read the header of a datagram."""
        return cls(wrapped(datagram[0]), wrapped(datagram[1]))


def wrapped(number: int) -> int:
    """Wrap a number, or a difference of numbers, to a signed byte."""
    return (number + 128) % 256 - 128


@dataclass
class Counters:
    """Counts of the datagrams that have arrived at one side."""

    accepted: int = 0
    """Accepted, whether returned or superseded."""
    superseded: int = 0
    """Superseded: accepted, but a newer one was already queued."""
    wrong_size: int = 0
    """Dropped: not a header and a packet of the expected kind."""
    not_finite: int = 0
    """NaN or infinite number in the packet; dropped where the link refuses such packets."""
    repeated: int = 0
    """Dropped: a copy of the newest one."""
    late: int = 0
    """Dropped: sent before the newest one."""
    lost: int = 0
    """Missing numbers between accepted datagrams: lost, late or refused."""
    foreign: int = 0
    """Dropped: not sent by the peer."""
    restarts: int = 0
    """Number of restarts of the peer."""


class Link:
    """Sequence numbers of one side, and its checks of arriving datagrams.

    Args:
        sends: kind of packets to the peer.
        receives: kind of packets from the peer.
        refuse_not_finite: drop packets with NaN or infinite numbers. A robot must drop such
            commands; a controller need not, as its estimator bridges single bad readings.
    """

    def __init__(self, sends: Packet, receives: Packet, *, refuse_not_finite: bool) -> None:
        self.sends, self.receives = sends, receives
        self.counters = Counters()
        """Counts of arrived datagrams."""
        self.step: int | None = None
        """Difference of the last two accepted numbers; 1 without loss."""
        self._refuse = refuse_not_finite
        self._sent = 0
        self._newest: bytes | None = None

    @property
    def size(self) -> int:
        """Bytes of an arriving datagram."""
        return HEADER_SIZE + self.receives.size

    def datagram(self, record: np.ndarray) -> bytes:
        """Build the next datagram.

        Raises:
            ShapeError: the record is of another kind than `sends`.
        """
        payload = self.sends.pack(record)
        self._sent = wrapped(self._sent + 1)
        received = 0 if self._newest is None else Header.from_bytes(self._newest).sequence
        return Header(self._sent, received).to_bytes() + payload

    def open(self, datagram: bytes, *, silent: bool = False) -> np.ndarray | None:
        """Check and count a datagram; return its packet, None if it is dropped.

        A repeated number with other content is accepted: the public simulator repeats its numbers
        until it receives the next command.

        Args:
            datagram: header and payload.
            silent: the peer has been silent for so long that a late number means its restart.
        """
        counters = self.counters
        if len(datagram) != self.size:
            counters.wrong_size += 1
            return None
        record = self.receives.unpack(datagram[HEADER_SIZE:])
        finite = self.receives.is_finite(record)
        if self._refuse and not finite:
            counters.not_finite += 1
            return None
        header = Header.from_bytes(datagram)
        if not self._is_new(header, datagram, silent):
            return None
        self._newest = datagram
        counters.not_finite += not finite
        counters.accepted += 1
        return record

    def is_valid(self, datagram: bytes) -> bool:
        """True unless the size or the numbers of a datagram are refused; counts nothing."""
        receives = self.receives
        return len(datagram) == self.size and not (
            self._refuse and not receives.is_finite(receives.unpack(datagram[HEADER_SIZE:]))
        )

    def restart(self) -> None:
        """Forget the peer's numbers for a new peer; the counts continue."""
        self._newest = self.step = None
        self.counters.restarts += 1

    def _is_new(self, header: Header, datagram: bytes, silent: bool) -> bool:
        """Check whether a datagram is newer than the newest one; count it if not."""
        if self._newest is None:
            return True
        step = wrapped(header.sequence - Header.from_bytes(self._newest).sequence)
        if datagram == self._newest:
            self.counters.repeated += 1
            return False
        if step < 0 and silent:
            self.restart()
            return True
        if step < 0:
            self.counters.late += 1
            return False
        self.step = step
        self.counters.lost += max(step - 1, 0)
        return True
