"""ZIP archives taken apart, put together, and with programs hidden inside."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from aslip.files.archive import SUMS, sums


def unzipped(data: bytes) -> dict[str, bytes]:
    """Read the entries of an archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(parts: Mapping[str, bytes]) -> bytes:
    """Write an archive of entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def forged(parts: Mapping[str, bytes]) -> bytes:
    """Write an archive of entries with their present hashes."""
    rest = {name: content for name, content in parts.items() if name != SUMS}
    return zipped({**rest, SUMS: sums(rest)})


class Program:
    """Object whose unpickling runs code that creates a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def programs(data: bytes, program: Program) -> Iterator[bytes]:
    """Hide a program in an archive in several ways, with right hashes.

    It replaces all arrays, one array, or all text, or stands beside them under names that NumPy,
    TorchRL and TensorDict unpickle.
    """
    saved, objects = io.BytesIO(), io.BytesIO()
    torch.save(program, saved)
    array = np.empty(1, dtype=object)
    array[0] = program
    np.save(objects, array, allow_pickle=True)
    pickled = pickle.dumps({"data": program})

    parts = unzipped(data)
    arrays = [name for name in parts if name.endswith(".npy")]
    for changed in (arrays, arrays[:1]):
        for content in (objects.getvalue(), pickled, saved.getvalue()):
            yield forged({**parts, **dict.fromkeys(changed, content)})
    texts = [name for name in parts if name.endswith(".json")]
    yield forged({**parts, **dict.fromkeys(texts, pickled)})
    folders = {name.rpartition("/")[0] for name in parts}
    beside = {
        "state.pt": saved.getvalue(),
        "other.pickle": pickled,
        "extra.npy": objects.getvalue(),
    }
    yield forged({**parts, **{f"{f}/{name}": c for f in folders for name, c in beside.items()}})
