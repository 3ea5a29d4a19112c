"""Sockets of twins and clients on loopback, and threads in which robots are served."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from aslip.network.wire import (
    CASSIE_OUT,
    LOOPBACK,
    PD_IN,
    STATE_OUT,
    USER_IN,
    Address,
    Endpoint,
    Link,
)

ANY_PORT = Address(LOOPBACK, 0)


def robot_socket(raw: bool = False) -> Endpoint:
    """Socket of a robot on any free port."""
    kinds = (CASSIE_OUT, USER_IN) if raw else (STATE_OUT, PD_IN)
    return Endpoint(Link(*kinds, refuse_not_finite=True), ANY_PORT)


def socket_to(robot: Address, raw: bool = False) -> Endpoint:
    """Socket of a client on any free port."""
    kinds = (USER_IN, CASSIE_OUT) if raw else (PD_IN, STATE_OUT)
    return Endpoint(Link(*kinds, refuse_not_finite=False), ANY_PORT, robot)


@contextmanager
def serving(serve: Callable[..., Any], *arguments: Any, raw: bool = False) -> Iterator[Endpoint]:
    """Socket of a robot that `serve(*arguments, socket, stop)` plays in a thread."""
    ended = threading.Event()
    with robot_socket(raw) as server:
        thread = threading.Thread(target=serve, args=(*arguments, server, ended.is_set))
        thread.start()
        try:
            yield server
        finally:
            ended.set()
            thread.join()
