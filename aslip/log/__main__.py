"""Logs from a shell: `python -m aslip.log info | check | recover | replay`."""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path
from typing import NoReturn

from aslip import log
from aslip.errors import AslipError
from aslip.files.assets import user_path
from aslip.training.command_line import prepare_program, usage_error
from aslip.walking import markdown


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit status 0 for success, 1 for a faulty log, 2 for an error."""
    prepare_program()
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except (AslipError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


class _Parser(argparse.ArgumentParser):
    """Parser with the error messages of all programs of this package."""

    def error(self, message: str) -> NoReturn:
        """Exit because of a wrong command line."""
        usage_error(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m aslip.log", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, run: object, text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text, description=text)
        added.add_argument("log", type=user_path, help="MCAP file")
        added.set_defaults(run=run)
        return added

    command("info", _info, "List metadata, attachments and topics of a log.")
    command("check", _check, "Check that a log is complete and intact.")
    saving = command("recover", _recover, "Save the intact part of an unfinished or damaged log.")
    saving.add_argument("--out", type=Path, help="file to write; <name>.recovered.mcap by default")
    again = command("replay", _replay, "Simulate a log again, from the file alone.")
    again.add_argument(
        "--start", type=float, default=0.0, help="start from the last state before this time [s]"
    )
    again.add_argument(
        "--drift",
        action="store_true",
        help="continue where states differ, even with another MuJoCo, and report by how much",
    )
    again.add_argument(
        "--verify",
        action="store_true",
        help="replay from the start and from the middle; fail unless every state is bit-equal",
    )
    return parser


def _info(options: argparse.Namespace) -> int:
    recording = log.read(options.log)
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
    problems = log.check(options.log)
    for problem in problems:
        print(f"{options.log}: {problem}")
    if not problems:
        print(f"{options.log}: complete and intact")
    return int(bool(problems))


def _recover(options: argparse.Namespace) -> int:
    saved = log.recover(options.log, options.out)
    print(f"{saved.path}: {saved.messages} messages, to {saved.until:.2f} s")
    if saved.skipped_chunks:
        print(f"left out: {saved.skipped_chunks} damaged chunks")
    for name in saved.dropped:
        print(f"left out: damaged attachment {name!r}")
    print(f"damage: {saved.reason or 'none'}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    from aslip.log.playback import TOPICS, low_level_differs

    recording = log.read(options.log, TOPICS)
    starts = [options.start]
    if options.verify:
        starts.append((options.start + float(recording["/state"].time[-1])) / 2)
    results = [log.replay(recording, start, strict=not options.drift) for start in starts]
    for result in results:
        summary = (
            f"from {result.start:.2f} s: {result.steps} policy steps, {result.compared} states"
        )
        if result.equal:
            print(f"{summary}, all bit-equal")
            continue
        print(
            f"{summary}; differs at {result.diverged_at:.2f} s"
            f" by up to {result.largest_difference:.3g}"
        )
        if low_level_differs(recording):
            print(
                "the log was made with other code of the drive, the sensors or the robot: aslip"
                f" {recording.metadata.get('version/aslip')}"
            )
    if options.drift:
        print(_drift(results[0]))
    return int(options.verify and not all(result.equal for result in results))


def _drift(result: log.Replay) -> str:
    """Format a table of the difference of each state."""
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
