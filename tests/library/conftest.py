"""A small library to damage."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from aslip.library import GaitLibrary
from aslip.library.file import GaitTable, write_library
from tests.helpers import MADE_BY


@pytest.fixture(scope="session")
def small(library: GaitLibrary) -> GaitLibrary:
    """Two gaits of eight samples."""
    table = library.table
    per_gait = {f.name: getattr(table, f.name)[[5, 10]] for f in fields(GaitTable)}
    thinned = {n: v[:, ::16] if v.ndim == 3 else v for n, v in per_gait.items()}
    return GaitLibrary([library.gaits[5], library.gaits[10]], GaitTable(**thinned))


@pytest.fixture
def file(small: GaitLibrary, tmp_path: Path) -> Path:
    """The small library in a file."""
    path = tmp_path / "gaits.npz"
    write_library(path, small.gaits, small.table, MADE_BY)
    return path
