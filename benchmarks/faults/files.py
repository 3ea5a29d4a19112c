"""Faults of files: 1000 damaged ones of each kind, and what reading them does.

    python -m benchmarks.faults.files                    # every kind
    python -m benchmarks.faults.files --kinds policy

A damaged file is survived if it is refused with one of the package's errors, or if it loads with
the content of the whole file (a date in an archive has no meaning). One that was forged on purpose,
so that its checksums are right, may load with other content. Reading it, and replaying a log, must
not end the process and must not take more than `MEMORY` on top of what the process had.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import AslipError, FileDamagedError, one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Which files, and how many."""

    kinds: tuple[str, ...] = ()
    """Kinds of files; all by default."""
    count: int = 1000
    """Damaged files of each kind."""
    seed: int = 0
    """Seed of everything random."""


if __name__ == "__main__":
    # before the imports below, which take seconds
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
from benchmarks.faults.archives import Program, forged, programs, unzipped, zipped
from benchmarks.faults.kinds import KINDS, Kind

MEMORY = 2.0**30
"""Memory that reading a damaged file may take [bytes]."""

Damage = Callable[[bytes, np.random.Generator], bytes]
"""Makes a damaged file of a whole one."""


# ----------------------------------------------------------------- damage to any file


def one_bit(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip one bit."""
    offset = int(rng.integers(len(data)))
    return data[:offset] + bytes([data[offset] ^ 1 << int(rng.integers(8))]) + data[offset + 1 :]


def one_byte(data: bytes, rng: np.random.Generator) -> bytes:
    """Set one byte to a random value."""
    offset = int(rng.integers(len(data)))
    return data[:offset] + rng.bytes(1) + data[offset + 1 :]


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """End the file early."""
    return data[: int(rng.integers(len(data)))]


def zeroed(data: bytes, rng: np.random.Generator) -> bytes:
    """Set up to 4 KiB to zero, as a lost sector does."""
    offset, size = int(rng.integers(len(data))), int(rng.integers(1, 4097))
    size = min(size, len(data) - offset)
    return data[:offset] + bytes(size) + data[offset + size :]


def longer(data: bytes, rng: np.random.Generator) -> bytes:
    """Insert up to 4 KiB of random bytes."""
    offset, size = int(rng.integers(len(data) + 1)), int(rng.integers(1, 4097))
    return data[:offset] + rng.bytes(size) + data[offset:]


ANY_FILE: dict[str, Damage] = {f.__name__: f for f in (one_bit, one_byte, cut, zeroed, longer)}
"""Damage to a file of any format."""


# -------------------------------------------------- damage inside an archive, checksums right


def _entry(change: Damage) -> Damage:
    """Damage to one entry of a ZIP archive, whose CRC is then that of the damaged entry."""

    def damage(data: bytes, rng: np.random.Generator) -> bytes:
        parts = unzipped(data)
        name = str(rng.choice(sorted(parts)))
        return zipped({**parts, name: change(parts[name], rng)})

    return damage


def _emptied(data: bytes, rng: np.random.Generator) -> bytes:
    del data, rng
    return b""


def _not_finite(data: bytes, rng: np.random.Generator) -> bytes:
    """Set the end, where arrays have their numbers, to ones: NaN in any precision."""
    size = min(len(data), 8 * int(rng.integers(1, 100)))
    return data[: len(data) - size] + b"\xff" * size


def _other_number(data: bytes, rng: np.random.Generator) -> bytes:
    """Put another number in the place of one in plain text, such as a shape."""
    digits = [i for i, byte in enumerate(data) if 48 <= byte <= 57]
    if not digits:
        return _emptied(data, rng)
    place = int(rng.choice(digits))
    number = str(rng.choice([0, -1, 7, 10**5, 10**9, 10**30])).encode()
    return data[:place] + number + data[place + 1 :]


def _removed(data: bytes, rng: np.random.Generator) -> bytes:
    parts = unzipped(data)
    del parts[str(rng.choice(sorted(parts)))]
    return zipped(parts)


def _swapped(data: bytes, rng: np.random.Generator) -> bytes:
    parts = unzipped(data)
    one, other = map(str, rng.choice(sorted(parts), 2, replace=False))
    return zipped({**parts, one: parts[other], other: parts[one]})


def _added(data: bytes, rng: np.random.Generator) -> bytes:
    parts = unzipped(data)
    name = str(rng.choice(sorted(parts)))
    return zipped({**parts, f"{name}{rng.integers(9)}": parts[name]})


ARCHIVE: dict[str, Damage] = {
    "entry: one bit": _entry(one_bit),
    "entry: one byte": _entry(one_byte),
    "entry: emptied": _entry(_emptied),
    "entry: cut": _entry(lambda data, rng: cut(data or b"x", rng)),
    "entry: longer": _entry(longer),
    "entry: not finite": _entry(_not_finite),
    "entry: other number": _entry(_other_number),
    "entry: removed": _removed,
    "entry: swapped": _swapped,
    "entry: added": _added,
}
"""Damage to the entries of a ZIP archive that is itself intact."""


def _forged(damage: Damage) -> Damage:
    """Damage whose hashes are right, too: what a stranger may have written on purpose."""
    return lambda data, rng: forged(unzipped(damage(data, rng)))


FORGED = "forged "
"""Start of the names of damage with right hashes."""


# ------------------------------------------------------------------------ the judge

SURVIVED = ("refused", "same content", "another file")
"""Outcomes of a damaged file that are as they should be."""


def damages(kind: Kind) -> dict[str, Damage]:
    """Ways to damage a file of a kind, by name."""
    ways = ANY_FILE | dict(kind.damages)
    if kind.archive:
        ways |= ARCHIVE | {FORGED + name: _forged(way) for name, way in ARCHIVE.items()}
    return ways


def outcome(kind: Kind, path: Path, whole: Any) -> str:
    """Outcome of reading a damaged file; `whole` is the content of the intact one."""
    before = peak_memory()
    try:
        content = kind.load(path)
        found = "same content" if kind.same(content, whole) else "other content"
    except AslipError as error:
        found = "too much memory" if _out_of_memory(error) else "refused"
    except Exception as error:
        found = f"{type(error).__name__}"
    return "too much memory" if (peak_memory() - before) * 2**30 > MEMORY else found


def _out_of_memory(error: BaseException | None) -> bool:
    """Whether an allocation failed somewhere below an error."""
    while error is not None:
        if isinstance(error, MemoryError) or "allocate" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _limit_memory() -> None:
    """Let allocations of far more than `MEMORY` fail, instead of the machine."""
    import resource  # not on Windows

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + int(2 * MEMORY)
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _damaged(kind: Kind, whole: bytes, i: int, seed: int) -> tuple[str, bytes]:
    """The damage that file i has, and its bytes."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.name.encode()), i])
    ways = damages(kind)
    name = list(ways)[i % len(ways)]
    data = ways[name](whole, rng)
    while data == whole:
        data = ways[name](data, rng)
    return name, data


def _judge(name: str, folder: Path, first: int, last: int, seed: int, to: Connection) -> None:
    """Read damaged files in a process of its own; send the outcome of each."""
    torch.set_num_threads(1)
    kind = KINDS[name]
    path = folder / f"whole{kind.suffix}"
    data, whole = path.read_bytes(), kind.load(path)
    spoilt = folder / f"damaged{kind.suffix}"
    _limit_memory()
    for i in range(first, last):
        name, content = _damaged(kind, data, i, seed)
        spoilt.write_bytes(content)
        found = outcome(kind, spoilt, whole)
        in_order = found == "other content" and name.startswith(FORGED)
        to.send("another file" if in_order else found)


def outcomes(kind: Kind, count: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    """Damage and outcome of each file; a process that one ends is replaced."""
    path = folder / f"whole{kind.suffix}"
    kind.write(path)
    data, i = path.read_bytes(), 0
    context = multiprocessing.get_context("spawn")
    while i < count:
        ours, theirs = context.Pipe(duplex=False)
        args = (kind.name, folder, i, count, seed, theirs)
        process = context.Process(target=_judge, args=args, daemon=True)
        process.start()
        theirs.close()
        with suppress(EOFError):
            while i < count:
                found = ours.recv()
                yield _damaged(kind, data, i, seed)[0], found
                i += 1
        process.join()
        if i < count:
            yield _damaged(kind, data, i, seed)[0], f"process ended ({process.exitcode})"
            i += 1


def damaged(kind: str, count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: refused, or nothing is different; see the module."""
    counts = table(kind, count, int(rng.integers(2**31)), folder)
    for (damage, found), number in sorted(counts.items()):
        if found not in SURVIVED:
            tqdm.write(f"{number} of {kind}, {damage}: {found}")
    return sum(number for (_, found), number in counts.items() if found in SURVIVED)


def strangers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the hidden program has not run, whether the file is refused or read without it."""
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
    """Numbers of files by damage and outcome."""
    below = folder / kind
    below.mkdir(exist_ok=True)
    return Counter(outcomes(KINDS[kind], count, seed, below))


# ------------------------------------------------------------------------- command


def main(config: Config) -> None:
    """Print how many files were survived, by kind and damage."""
    rows: list[list[str]] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in config.kinds or KINDS:
            counts = table(kind, config.count, config.seed, Path(folder))
            for damage in damages(KINDS[kind]):
                found = {o: n for (d, o), n in counts.items() if d == damage}
                good = [str(found.pop(name, 0)) for name in SURVIVED]
                rows.append([kind, damage, *good, ", ".join(f"{n} {o}" for o, n in found.items())])
    print(markdown(["kind", "damage", *SURVIVED, "not survived"], rows))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
