"""ZIP archives: reading, writing, and forging, also with a hidden program inside."""

import io
import pickle
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from aslip.base.archive import SUMS, sums


def read_zip(data: bytes) -> dict[str, bytes]:
    """Entries of an archive, by name."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write_zip(parts: Mapping[str, bytes]) -> bytes:
    """Archive of entries, as bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def forge_archive(parts: Mapping[str, bytes]) -> bytes:
    """Archive of entries with hashes that match them."""
    rest = {name: content for name, content in parts.items() if name != SUMS}
    return write_zip({**rest, SUMS: sums(rest)})


class Program:
    """Object that creates a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def programs(data: bytes, program: Program) -> Iterator[bytes]:
    """Hide a program in an archive, in each of eight ways, with matching hashes.

    The program replaces all arrays, one array or all text, or is added under names that NumPy,
    TorchRL and TensorDict unpickle.
    """
    saved, objects = io.BytesIO(), io.BytesIO()
    torch.save(program, saved)
    array = np.empty(1, dtype=object)
    array[0] = program
    np.save(objects, array, allow_pickle=True)
    pickled = pickle.dumps({"data": program})

    parts = read_zip(data)
    arrays = [name for name in parts if name.endswith(".npy")]
    for changed in (arrays, arrays[:1]):
        for content in (objects.getvalue(), pickled, saved.getvalue()):
            yield forge_archive({**parts, **dict.fromkeys(changed, content)})
    texts = [name for name in parts if name.endswith(".json")]
    yield forge_archive({**parts, **dict.fromkeys(texts, pickled)})
    folders = {name.rpartition("/")[0] for name in parts}
    beside = {
        "state.pt": saved.getvalue(),
        "other.pickle": pickled,
        "extra.npy": objects.getvalue(),
    }
    yield forge_archive(
        {**parts, **{f"{f}/{name}": c for f in folders for name, c in beside.items()}}
    )


def forgeries(data: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """Change, swap or remove entries of an archive, with matching hashes."""
    parts = read_zip(data)
    names = sorted(parts.keys() - {SUMS})
    for name in rng.choice(names, min(8, len(names)), replace=False).tolist():
        content, other = parts[name], str(rng.choice(names))
        # NaN in any precision, and numbers of texts and of shapes
        changes = [b"", content[:-8] + b"\xff" * 8]
        numbers = list(re.finditer(rb"\d+", content))
        for number in (b"-1", b"1" + 30 * b"0") if numbers else ():
            start, end = numbers[int(rng.integers(len(numbers)))].span()
            changes.append(content[:start] + number + content[end:])
        yield from (forge_archive({**parts, name: change}) for change in changes)
        yield forge_archive({**parts, name: parts[other], other: content})
        yield forge_archive({key: part for key, part in parts.items() if key != name})
