"""Processes beside this one, which end with it, and signals that end this one."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import FrameType, ModuleType
from typing import Final

ENDINGS: Final = tuple(
    getattr(signal, name)
    for name in ("SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU")
    if hasattr(signal, name)
)
"""Signals that end a program: by SIGTERM, a closed terminal, and schedulers before a time limit."""

_GROUPS, _LIMITS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def processors() -> int:
    """Number of processors that this process may use: by its affinity, or its container's quota."""
    affinity = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, math.ceil(min(affinity or 1, _quota())))


def _quota() -> float:
    """Processors that the control groups of this process, versions 1 and 2, let it use."""
    quotas = [math.inf]
    for line in _GROUPS.read_text().splitlines() if _GROUPS.exists() else ():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        files = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        # a container may see its own group as the root, under the path that the host knows
        for group in (Path(path), *Path(path).parents):
            folder = _LIMITS / ("cpu" if controllers else "") / str(group).lstrip("/")
            # no file, or "max": no limit here
            with contextlib.suppress(OSError, ValueError):
                quota, period = map(
                    float, " ".join((folder / f).read_text() for f in files).split()
                )
                quotas += [quota / period] if quota > 0 else []
    return min(quotas)


class _Process(SpawnProcess):
    """Process that does not run the main script again, which so needs no main guard."""

    @staticmethod
    def _Popen(process_obj: SpawnProcess) -> object:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return SpawnProcess._Popen(process_obj)  # pyright: ignore
        finally:
            sys.modules["__main__"] = main


class Spawned(SpawnContext):
    """Context of `multiprocessing` whose processes know nothing of the main script."""

    Process = _Process


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor | None]:
    """Pool of processes, which end with this one, even if it is killed; None for one worker.

    The processes do not run the main script: its functions and classes cannot be sent to them.
    """
    if workers <= 1:
        yield None
        return
    # threads would wait for each other, and forks of a process with threads may hang
    with ProcessPoolExecutor(workers, Spawned(), initializer=end_with_parent) as pool:
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """End this process when its parent is killed, instead of waiting for it for ever."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def endings() -> list[int]:
    """Signals of `ENDINGS` that would end this process now, in its main thread.

    Others are ignored, as SIGHUP under nohup, or have a handler.
    """
    if threading.current_thread() is not threading.main_thread():
        return []
    return [number for number in ENDINGS if signal.getsignal(number) is signal.SIG_DFL]


@contextmanager
def signals_exit() -> Iterator[None]:
    """Context in which `endings` raise SystemExit, with exit status 128 + number.

    After the first one all of them are ignored until the context ends: shells and systemd send
    several at once, and the second must not disturb the saving.
    """
    taken = endings()

    def leave(number: int, _: FrameType | None) -> None:
        for other in taken:
            signal.signal(other, signal.SIG_IGN)
        sys.exit(128 + number)

    try:
        for number in taken:
            signal.signal(number, leave)
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def signals_raised() -> Iterator[None]:
    """Context that raises what a signal handler raised within, such as KeyboardInterrupt.

    Libraries in C++ that call handlers may turn an interrupt into an error of their own, or lose
    it.
    """
    raised: list[BaseException] = []

    def kept(handler: Callable[[int, FrameType | None], object]) -> Callable[..., None]:
        def handle(number: int, frame: FrameType | None) -> None:
            try:
                handler(number, frame)
            except BaseException as error:
                raised.append(error)
                raise

        return handle

    handlers = {}
    if threading.current_thread() is threading.main_thread():
        found = {number: signal.getsignal(number) for number in signal.valid_signals()}
        handlers = {number: (kept(h), h) for number, h in found.items() if callable(h)}
    try:
        for number, (new, _) in handlers.items():
            signal.signal(number, new)
        yield
    finally:
        for number, (new, old) in handlers.items():
            # a handler may have set another, such as to ignore the signal
            if signal.getsignal(number) is new:
                signal.signal(number, old)
        if raised:
            raise raised[0] from None
