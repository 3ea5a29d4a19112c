"""Command lines of programs: dataclasses become flags, errors become one line.

Programs parse before they import PyTorch, so that `--help` and typos cost no seconds. Programs with
a loop in real time print with `say` and `Reports`, which never wait for a reader.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import functools
import io
import math
import os
import queue
import shlex
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, TypeVar

from aslip.base.imports import extras
from aslip.errors import AslipError

Settings = TypeVar("Settings")

# lines that wait for the reader of the output; further ones are dropped
_MOST_LINES = 100
# time between two lines about events of one kind [s]
_REPORT_PERIOD = 1.0
# longest wait for the reader of the output at the end of a program [s]
_LAST_WAIT = 1.0


def command_line(
    kind: type[Settings], default: Settings | None = None, arguments: Sequence[str] | None = None
) -> Settings:
    """Read settings from flags named after the fields of a dataclass.

    Args:
        kind: the dataclass.
        default: defaults of the flags; those of the dataclass by default.
        arguments: words of the command line; those of this program by default.

    Raises:
        SystemExit: after `--help`, or after a message about a mistake (exit status 2).
    """
    prepare_program()
    with extras():
        import tyro

    given: dict[str, Any] = {} if default is None else {"default": default}
    return tyro.cli(kind, args=arguments, prog=program(), **given)


def preset_command_line(
    presets: Mapping[str, Settings],
    descriptions: Mapping[str, str],
    arguments: Sequence[str] | None = None,
) -> Settings:
    """Read settings from the name of a preset, the first by default, and flags.

    Args:
        presets: settings by name.
        descriptions: one sentence per preset, for `--help`.
        arguments: words of the command line; those of this program by default.

    Raises:
        SystemExit: as in `command_line`.
    """
    prepare_program()
    with extras():
        import tyro

    kind = tyro.extras.subcommand_type_from_defaults(
        presets, descriptions={name: descriptions.get(name, "") for name in presets}
    )
    return tyro.cli(
        kind,
        args=arguments,
        prog=program(),
        default=next(iter(presets.values())),
        config=(tyro.conf.CascadeSubcommandArgs,),
    )


def prepare_program() -> None:
    """Let errors on import be one line, and output that cannot be shown or read be no error.

    Characters that a terminal lacks are replaced. When the reader of a pipe or the terminal is
    gone, the program goes on and ends as if its output were read: trainings, walks and robots do
    not depend on it.
    """
    sys.excepthook = _one_line
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        # not the substitutes of notebooks and tests
        if isinstance(stream, io.TextIOWrapper) and stream is getattr(sys, f"__{name}__"):
            stream.flush()
            raw = _Output(stream.fileno(), "w", closefd=False)
            unbuffered = stream.write_through
            output = io.TextIOWrapper(
                raw if unbuffered else io.BufferedWriter(raw),  # pyright: ignore
                stream.encoding,
                "replace",
                line_buffering=stream.line_buffering,
                write_through=unbuffered,
            )
            setattr(sys, name, output)


class _Output(io.FileIO):
    """File whose content is dropped once nobody reads it."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EIO):
                raise
            # for C libraries and child processes, too
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), self.fileno())
            return len(data)


def _one_line(kind: type[BaseException], error: BaseException, *trace: Any) -> None:
    """Print an uncaught error, in one line if the user can fix it."""
    try:
        with extras():
            raise error
    except AslipError as known:
        print(f"error: {known}", file=sys.stderr)
    except BaseException:
        sys.__excepthook__(kind, error, *trace)


def usage_error(message: str) -> NoReturn:
    """Exit because of a wrong command line, with the reason and a hint to `--help`."""
    print(f"error: {message}\nfor all options: {program()} --help", file=sys.stderr)
    raise SystemExit(2)


_program = ""


def set_program(command: str) -> None:
    """Name the command that started this program, where Python does not know it."""
    global _program
    _program = command


def program() -> str:
    """Command that started this program, without its arguments."""
    if _program:
        return _program
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is not None:
        return f"python -m {spec.name.removesuffix('.__main__')}"
    return shlex.join(["python", sys.argv[0]])


def this_command() -> str:
    """Command that started this program, with its arguments."""
    return f"{program()} {shlex.join(sys.argv[1:])}".rstrip()


def say(text: str) -> None:
    """Print a line at once, on another thread; drop it if nobody reads the output."""
    try:
        descriptor, encoding = sys.stdout.fileno(), sys.stdout.encoding
    except (AttributeError, OSError, ValueError):  # no output, a notebook's, or a closed one
        with contextlib.suppress(OSError, ValueError):
            print(text, flush=True)
        return
    with contextlib.suppress(queue.Full):
        _printer().put_nowait((descriptor, f"{text}\n".encode(encoding, "backslashreplace")))


@functools.cache
def _printer() -> queue.Queue[tuple[int, bytes]]:
    """Lines for the thread that prints them."""
    lines: queue.Queue[tuple[int, bytes]] = queue.Queue(_MOST_LINES)

    def write() -> None:
        while True:
            descriptor, line = lines.get()
            # not through sys.stdout, whose lock would be held while nobody reads
            with contextlib.suppress(OSError):
                while line:
                    line = line[os.write(descriptor, line) :]
            lines.task_done()

    def finish() -> None:
        end = time.monotonic() + _LAST_WAIT
        while lines.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.001)

    threading.Thread(target=write, name="output", daemon=True).start()
    atexit.register(finish)
    return lines


class Reports:
    """Lines about events that others cause as often as they like.

    Of each kind of event a line is said at once, then one a second at most, about the newest event
    and with the number of events.

    Args:
        say: function that prints a line.
        clock: monotonic clock [s].
    """

    def __init__(
        self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._clock = say, clock
        self._waiting: dict[str, tuple[int, str]] = {}
        self._due: dict[str, float] = {}

    def add(self, kind: str, text: str) -> None:
        """Add an event of a kind; the text describes it."""
        self._waiting[kind] = self._waiting.get(kind, (0, ""))[0] + 1, text

    def say(self) -> None:
        """Say the lines that are due; to be called in each turn of a loop."""
        if not self._waiting:
            return
        now = self._clock()
        for kind in [k for k in self._waiting if self._due.get(k, -math.inf) <= now]:
            count, text = self._waiting.pop(kind)
            self._due[kind] = now + _REPORT_PERIOD
            self._say(text if count == 1 else f"{text} ({count} times)")
