"""Logs from a shell: `python -m aslip.log info | check | recover | replay`."""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path
from typing import NoReturn

from aslip.errors import AslipError
from aslip.log.integrity import check
from aslip.log.playback import TOPICS, Replay, low_level_differs, replay
from aslip.log.reader import read
from aslip.log.recovery import recover
from aslip.training.command_line import usage_error
from aslip.walking import markdown


def main(arguments: list[str] | None = None) -> int:
    """Run a command; the exit status is 0 if all is well, 1 if the log is not, 2 on an error."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except (AslipError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


class _Parser(argparse.ArgumentParser):
    """A parser that tells mistakes as all programs of this package do."""

    def error(self, message: str) -> NoReturn:
        """End the program for a wrong command line."""
        usage_error(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m aslip.log", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, run: object, text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text, description=text)
        added.add_argument("log", type=Path, help="the MCAP file")
        added.set_defaults(run=run)
        return added

    command("info", _info, "Tell what is in a log.")
    command("check", _check, "Check that a log is whole and intact.")
    saving = command("recover", _recover, "Save what is left of an unfinished or damaged log.")
    saving.add_argument("--out", type=Path, help="the new log; <name>.recovered.mcap by default")
    again = command("replay", _replay, "Simulate a log again, from the file alone.")
    again.add_argument(
        "--start", type=float, default=0.0, help="begin from the state before this time [s]"
    )
    again.add_argument(
        "--drift",
        action="store_true",
        help="go on where states differ, also with another MuJoCo, and tell by how much",
    )
    again.add_argument(
        "--verify",
        action="store_true",
        help="from the start and from the middle, and fail unless every state is equal to the bit",
    )
    return parser


def _info(options: argparse.Namespace) -> int:
    recording = read(options.log)
    print(f"{options.log}: {options.log.stat().st_size / 1e6:.2f} MB")
    for name, value in {**recording.metadata, **recording.end}.items():
        print(f"  {name:24} {value}")
    print("attachments")
    for name, data in recording.attachments.items():
        print(f"  {name:24} {len(data)} bytes")
    print("topics")
    for topic, series in recording.series.items():
        span = f"{series.time[0]:.2f} to {series.time[-1]:.2f} s"
        print(f"  {topic:24} {len(series):6} messages, {span}, {len(series.columns)} columns:")
        names = ", ".join(series.columns)
        print(textwrap.fill(names, 98, initial_indent=" " * 4, subsequent_indent=" " * 4))
    return 0


def _check(options: argparse.Namespace) -> int:
    problems = check(options.log)
    for problem in problems:
        print(f"{options.log}: {problem}")
    if not problems:
        print(f"{options.log}: whole and intact")
    return int(bool(problems))


def _recover(options: argparse.Namespace) -> int:
    saved = recover(options.log, options.out)
    print(f"{saved.path}: {saved.messages} messages, to {saved.until:.2f} s")
    if saved.skipped_chunks:
        print(f"left out: {saved.skipped_chunks} damaged chunks")
    for name in saved.dropped:
        print(f"left out: the attachment {name!r}, which is damaged")
    print(f"what was wrong: {saved.reason or 'nothing'}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    recording = read(options.log, TOPICS)
    starts = [options.start]
    if options.verify:
        starts.append((options.start + float(recording["/state"].time[-1])) / 2)
    results = [replay(recording, start, strict=not options.drift) for start in starts]
    for result in results:
        told = f"from {result.start:.2f} s: {result.steps} policy steps, {result.compared} states"
        if result.equal:
            print(f"{told}, all equal bit for bit")
            continue
        print(
            f"{told}; differs at {result.diverged_at:.2f} s"
            f" by up to {result.largest_difference:.3g}"
        )
        if low_level_differs(recording):
            print(
                "the log was made by another version of this package's drive, sensors or constants:"
                f" aslip {recording.metadata.get('version/aslip')}, other code"
            )
    if options.drift:
        print(_drift(results[0]))
    return int(options.verify and not all(result.equal for result in results))


def _drift(result: Replay) -> str:
    """Table of the difference of each state."""
    rows = [
        [f"{time:.2f}", f"{configuration:.3g}", f"{largest:.3g}"]
        for time, configuration, largest in zip(
            result.state_time, result.qpos_drift, result.drift, strict=True
        )
    ]
    table = markdown(["state at s", "configuration differs by m, rad", "any number by"], rows)
    return "\n".join([*result.doubts, table])


if __name__ == "__main__":
    raise SystemExit(main())
