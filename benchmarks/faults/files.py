"""Fault injection into files: outcomes of reading 1000 damaged files of each kind.

    python -m benchmarks.faults.files                    # every kind
    python -m benchmarks.faults.files --kinds policy

A damaged file is survived if it is refused with one of the package's errors, or loads with the
content of the intact file. A forged file, whose checksums match, may load with other content.
Reading a file or replaying a log must neither end the process nor take more than `MEMORY` of
additional memory.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import AslipError, FileDamagedError, one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Kinds and number of files."""

    kinds: tuple[str, ...] = ()
    """Kinds of files; empty for all."""
    count: int = 1000
    """Number of damaged files of each kind."""
    seed: int = 0
    """Seed of all random numbers."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import multiprocessing
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from aslip.training.provenance import peak_memory
from aslip.walking import markdown
from benchmarks.faults.archives import Program, forge_archive, programs, read_zip, write_zip
from benchmarks.faults.kinds import KINDS, Kind

MEMORY = 2.0**30
"""Additional memory that reading a damaged file may take [bytes]."""

Damage = Callable[[bytes, np.random.Generator], bytes]
"""Function from an intact file's bytes to a damaged file's."""


# ----------------------------------------------------------------- damage to any file


def flip_bit(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip one bit."""
    offset = int(rng.integers(len(data)))
    return data[:offset] + bytes([data[offset] ^ 1 << int(rng.integers(8))]) + data[offset + 1 :]


def replace_byte(data: bytes, rng: np.random.Generator) -> bytes:
    """Set one byte to a random value."""
    offset = int(rng.integers(len(data)))
    return data[:offset] + rng.bytes(1) + data[offset + 1 :]


def truncate(data: bytes, rng: np.random.Generator) -> bytes:
    """Truncate the file."""
    return data[: int(rng.integers(len(data)))]


def zero_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Zero up to 4 KiB, like a lost sector."""
    offset, size = int(rng.integers(len(data))), int(rng.integers(1, 4097))
    size = min(size, len(data) - offset)
    return data[:offset] + bytes(size) + data[offset + size :]


def insert_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Insert up to 4 KiB of random bytes."""
    offset, size = int(rng.integers(len(data) + 1)), int(rng.integers(1, 4097))
    return data[:offset] + rng.bytes(size) + data[offset:]


ANY_FILE: dict[str, Damage] = {
    f.__name__: f for f in (flip_bit, replace_byte, truncate, zero_bytes, insert_bytes)
}
"""Damage to a file of any format."""


# ---------------------------------------- damage to an archive's entries, checksums match


def _damage_entry(change: Damage) -> Damage:
    """Damage to one entry of a ZIP archive, with the CRC of the damaged entry."""

    def damage(data: bytes, rng: np.random.Generator) -> bytes:
        parts = read_zip(data)
        name = str(rng.choice(sorted(parts)))
        return write_zip({**parts, name: change(parts[name], rng)})

    return damage


def _empty(data: bytes, rng: np.random.Generator) -> bytes:
    del data, rng
    return b""


def _insert_nan(data: bytes, rng: np.random.Generator) -> bytes:
    """Set the last bytes, numbers of an array, to ones: NaN in any precision."""
    size = min(len(data), 8 * int(rng.integers(1, 100)))
    return data[: len(data) - size] + b"\xff" * size


def _replace_number(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a number in plain text, such as a shape."""
    digits = [i for i, byte in enumerate(data) if 48 <= byte <= 57]
    if not digits:
        return _empty(data, rng)
    place = int(rng.choice(digits))
    number = str(rng.choice([0, -1, 7, 10**5, 10**9, 10**30])).encode()
    return data[:place] + number + data[place + 1 :]


def _remove_entry(data: bytes, rng: np.random.Generator) -> bytes:
    parts = read_zip(data)
    del parts[str(rng.choice(sorted(parts)))]
    return write_zip(parts)


def _swap_entries(data: bytes, rng: np.random.Generator) -> bytes:
    parts = read_zip(data)
    one, other = map(str, rng.choice(sorted(parts), 2, replace=False))
    return write_zip({**parts, one: parts[other], other: parts[one]})


def _add_entry(data: bytes, rng: np.random.Generator) -> bytes:
    parts = read_zip(data)
    name = str(rng.choice(sorted(parts)))
    return write_zip({**parts, f"{name}{rng.integers(9)}": parts[name]})


ARCHIVE: dict[str, Damage] = {
    "entry: flip_bit": _damage_entry(flip_bit),
    "entry: replace_byte": _damage_entry(replace_byte),
    "entry: empty": _damage_entry(_empty),
    "entry: truncate": _damage_entry(lambda data, rng: truncate(data or b"x", rng)),
    "entry: insert_bytes": _damage_entry(insert_bytes),
    "entry: insert NaN": _damage_entry(_insert_nan),
    "entry: replace number": _damage_entry(_replace_number),
    "remove entry": _remove_entry,
    "swap entries": _swap_entries,
    "add entry": _add_entry,
}
"""Damage to the entries of an otherwise intact ZIP archive."""


def _forge(damage: Damage) -> Damage:
    """Damage followed by an update of the hashes, as an attacker could do."""
    return lambda data, rng: forge_archive(read_zip(damage(data, rng)))


FORGED = "forged "
"""Prefix of the names of damage with matching hashes."""


# -----------------------------------------------------------------------outcomes

SURVIVED = ("refused", "same content", "forged content")
"""Acceptable outcomes of reading a damaged file."""


def damages(kind: Kind) -> dict[str, Damage]:
    """Damage to a file of a kind, by name."""
    ways = ANY_FILE | dict(kind.damages)
    if kind.archive:
        ways |= ARCHIVE | {FORGED + name: _forge(way) for name, way in ARCHIVE.items()}
    return ways


def outcome(kind: Kind, path: Path, whole: Any) -> str:
    """Outcome of reading a damaged file; `whole` is the intact file's content."""
    before = peak_memory()
    try:
        content = kind.load(path)
        found = "same content" if kind.identical(content, whole) else "other content"
    except Exception as error:
        found = "refused" if isinstance(error, AslipError) else type(error).__name__
        found = "too much memory" if _out_of_memory(error) else found
    return "too much memory" if (peak_memory() - before) * 2**30 > MEMORY else found


def _out_of_memory(error: BaseException | None) -> bool:
    """Check whether a failed allocation is among the causes of an error."""
    while error is not None:
        if isinstance(error, MemoryError) or "allocate" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _limit_memory() -> None:
    """Make allocations of twice `MEMORY` fail rather than exhaust the machine."""
    import resource  # not on Windows

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + int(2 * MEMORY)
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _damage_file(kind: Kind, whole: bytes, i: int, seed: int) -> tuple[str, bytes]:
    """Name of the damage to file i, and the damaged bytes."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.name.encode()), i])
    ways = damages(kind)
    name = list(ways)[i % len(ways)]
    data = ways[name](whole, rng)
    while data == whole:
        data = ways[name](data, rng)
    return name, data


def _read_damaged(
    name: str, folder: Path, first: int, last: int, seed: int, to: Connection
) -> None:
    """Read damaged files `first` to `last`, and send the outcome of each."""
    torch.set_num_threads(1)
    kind = KINDS[name]
    path = folder / f"whole{kind.suffix}"
    data, whole = path.read_bytes(), kind.load(path)
    damaged = folder / f"damaged{kind.suffix}"
    _limit_memory()
    for i in range(first, last):
        name, content = _damage_file(kind, data, i, seed)
        damaged.write_bytes(content)
        found = outcome(kind, damaged, whole)
        forged = found == "other content" and name.startswith(FORGED)
        to.send("forged content" if forged else found)


def outcomes(kind: Kind, count: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    """Damage and outcome of each file; a crashed process is replaced."""
    path = folder / f"whole{kind.suffix}"
    kind.write(path)
    data, i = path.read_bytes(), 0
    context = multiprocessing.get_context("spawn")
    while i < count:
        ours, theirs = context.Pipe(duplex=False)
        args = (kind.name, folder, i, count, seed, theirs)
        process = context.Process(target=_read_damaged, args=args, daemon=True)
        process.start()
        theirs.close()
        with suppress(EOFError):
            while i < count:
                found = ours.recv()
                yield _damage_file(kind, data, i, seed)[0], found
                i += 1
        process.join()
        if i < count:
            yield _damage_file(kind, data, i, seed)[0], f"process ended ({process.exitcode})"
            i += 1


def damaged_files(kind: str, count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: an outcome in `SURVIVED`."""
    counts = table(kind, count, int(rng.integers(2**31)), folder)
    for (damage, found), number in sorted(counts.items()):
        if found not in SURVIVED:
            tqdm.write(f"{number} of {kind}, {damage}: {found}")
    return sum(number for (_, found), number in counts.items() if found in SURVIVED)


def hidden_programs(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the hidden program did not run, whether the file was refused or read."""
    del rng
    kinds, survived = [kind for kind in KINDS.values() if kind.archive], 0
    for i in range(count):
        kind, mark = kinds[i % len(kinds)], folder / f"ran-{i}"
        path = folder / f"stranger{kind.suffix}"
        kind.write(path)
        ways = list(programs(path.read_bytes(), Program(mark)))
        path.write_bytes(ways[i // len(kinds) % len(ways)])
        with suppress(FileDamagedError):
            kind.load(path)
        survived += not mark.exists()
    return survived


def table(kind: str, count: int, seed: int, folder: Path) -> Counter[tuple[str, str]]:
    """Number of files by damage and outcome."""
    below = folder / kind
    below.mkdir(exist_ok=True)
    return Counter(outcomes(KINDS[kind], count, seed, below))


# ------------------------------------------------------------------------- command


def main(config: Config) -> None:
    """Print the number of files by kind, damage and outcome."""
    rows: list[list[str]] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in config.kinds or KINDS:
            counts = table(kind, config.count, config.seed, Path(folder))
            for damage in damages(KINDS[kind]):
                found = {o: n for (d, o), n in counts.items() if d == damage}
                good = [str(found.pop(name, 0)) for name in SURVIVED]
                rows.append([kind, damage, *good, ", ".join(f"{n} {o}" for o, n in found.items())])
    print(markdown(["kind", "damage", *SURVIVED, "other outcomes"], rows))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
