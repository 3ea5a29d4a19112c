"""Files from strangers: programs hidden in every kind of archive."""

from __future__ import annotations

import contextlib
import io
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from aslip.errors import FileDamagedError
from benchmarks.faults.archives import forged, unzipped
from benchmarks.faults.kinds import KINDS


class Program:
    """Something whose unpickling runs code: it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def strangers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the program has not run, whether the file is refused or read without it."""
    del rng
    kinds, survived = [kind for kind in KINDS.values() if kind.archive], 0
    for i in range(count):
        kind, mark = kinds[i % len(kinds)], folder / f"ran-{i}"
        path = folder / f"stranger{kind.suffix}"
        kind.write(path)
        ways = list(programs(path.read_bytes(), Program(mark)))
        path.write_bytes(ways[i // len(kinds) % len(ways)])
        with contextlib.suppress(FileDamagedError):
            kind.load(path)
        survived += not mark.exists()
    return survived


def programs(data: bytes, program: Program) -> Iterator[bytes]:
    """Archives with a program inside, all hashes right.

    It is in the place of all arrays, of one array, of all text, or beside them under names that
    NumPy, TorchRL and TensorDict unpickle.
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
