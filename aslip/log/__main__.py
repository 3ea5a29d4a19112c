"""Logs from a shell: `python -m aslip.log info | check | export | recover | replay`."""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path
from typing import NoReturn

from aslip import log
from aslip.base.assets import user_path
from aslip.base.command_line import prepare_program, program, usage_error
from aslip.errors import AslipError


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit status 0 for success, 1 for a replay that differs, 2 for an error."""
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
    parser = _Parser(prog=program(), description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, run: object, text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text, description=text)
        added.add_argument("log", type=user_path, help="MCAP file")
        added.set_defaults(run=run)
        return added

    command("info", _info, "List metadata, attachments and topics of a log.")
    command("check", _check, "Check that a log is complete and intact, by all checksums.")
    tables = command("export", _export, "Write a log as tables, with a column per number.")
    tables.add_argument("--to", choices=("parquet", "csv", "hdf5"), required=True, help="format")
    tables.add_argument(
        "--out", type=user_path, help="<name>/ by default, with a file per topic; <name>.h5 of HDF5"
    )
    saving = command(
        "recover", _recover, "Save what comes before the damage or the end of an unfinished log."
    )
    saving.add_argument("--out", type=Path, help="file to write; <name>.recovered.mcap by default")
    again = command("replay", _replay, "Simulate a log again, and compare with its states.")
    again.add_argument(
        "--start", type=float, default=0.0, help="start from the last state before this time [s]"
    )
    again.add_argument(
        "--model", type=user_path, help="MJCF of a log of another robot than the shipped one"
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
    log.read(options.log)
    print(f"{options.log}: complete and intact")
    return 0


def _export(options: argparse.Namespace) -> int:
    print(log.export(log.read(options.log), options.to, options.out))
    return 0


def _recover(options: argparse.Namespace) -> int:
    saved = log.recover(options.log, options.out)
    print(f"{saved.path}: {saved.messages} messages, to {saved.until:.2f} s")
    print(f"damage: {saved.reason or 'none'}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    from aslip.log.playback import TOPICS

    recording = log.read(options.log, TOPICS)
    starts = [options.start]
    if options.verify:
        starts.append((options.start + float(recording["/state"].time[-1])) / 2)
    results = [log.replay(recording, start, model=options.model) for start in starts]
    for result in results:
        summary = (
            f"from {result.start:.2f} s: {result.steps} policy steps, {result.compared} states"
        )
        if result.equal:
            print(f"{summary}, all bit-equal")
            continue
        print(
            f"{summary}; differs from {result.diverged_at:.2f} s on, in the configuration by up to"
            f" {result.largest_difference:.3g} m or rad"
        )
        for doubt in result.doubts:
            print(doubt)
    return int(options.verify and not all(result.equal for result in results))


if __name__ == "__main__":
    raise SystemExit(main())
