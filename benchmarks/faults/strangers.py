"""Files from strangers: programs hidden in policies and checkpoints."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

import aslip
from aslip.checkpoint import load_checkpoint
from aslip.errors import FileDamagedError
from benchmarks.faults.checkpoints import finished
from benchmarks.faults.trainings import quiet


class Program:
    """Something whose unpickling runs code: it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def strangers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the program has not run, whether the file is refused or read without it."""
    del rng
    out, _, components = finished(folder)
    newest, survived = max((out / "checkpoints").iterdir()), 0
    for i in range(count):
        mark, path = folder / f"ran-{i}", folder / "stranger.zip"
        ways = _hidden(Program(mark))
        way = ways[i % len(ways)]
        _rewrite(newest if "arrays.npz" in way else out / "policy.zip", path, way)
        with contextlib.suppress(FileDamagedError), quiet():
            if "arrays.npz" in way:
                load_checkpoint(path, components)
            else:
                aslip.load_policy(path)
        survived += not mark.exists()
    return survived


def _hidden(program: Program) -> list[dict[str, bytes]]:
    """Files to put into the folder of each component; those of one way a dict.

    TorchRL reads "state.pt" in place of arrays, and "state.tdz" in place of a folder of them;
    TensorDict unpickles what is not a tensor, NumPy arrays of objects.
    """
    saved, archive, arrays = io.BytesIO(), io.BytesIO(), io.BytesIO()
    torch.save(program, saved)
    kind = json.dumps({"_type": "<class 'tensordict.tensorclass.NonTensorData'>"}).encode()
    pickled = pickle.dumps({"data": program})
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("meta.json", kind)
        file.writestr("other.pickle", pickled)
    objects = np.empty(1, dtype=object)
    objects[0] = program
    np.savez(arrays, allow_pickle=True, arr_0=objects)
    return [
        {"state.pt": saved.getvalue()},
        {"state/meta.json": kind, "state/other.pickle": pickled},
        {"state.tdz": archive.getvalue()},
        {"arrays.npz": arrays.getvalue()},
    ]


def _rewrite(source: Path, path: Path, files: Mapping[str, bytes]) -> None:
    """Copy an archive with other files in each component, but for what says how to read them."""
    with zipfile.ZipFile(source) as archive:
        manifest = json.loads(archive.read("manifest.json"))
        parts = {name: archive.read(name) for name in archive.namelist() if "/state/" not in name}
    for record in manifest["components"].values():
        record["files"] = sorted({"state.json", "tree.json"} & set(record["files"]) | set(files))
        parts |= {f"{record['path']}/{name}": data for name, data in files.items()}
    parts["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
