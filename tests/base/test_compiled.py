"""Compiled functions, with and without a usable cache."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba import config
from numba.core.caching import CacheImpl

from aslip.base import compiled as module


@pytest.fixture
def doubled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], tuple[float, list]]:
    """Compile a function as a new process would; its value, and warnings by then."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))

    def double(x: float) -> float:
        return 2 * x

    def call() -> tuple[float, list[Any]]:
        monkeypatch.setattr(module, "_warned", False)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            return module.compiled(double)(1.5), found

    return call


def test_damaged_files_of_the_cache_are_written_again(tmp_path, doubled) -> None:
    def files() -> list[Path]:
        return [path for path in sorted(tmp_path.rglob("*.nb?")) if path.is_file()]

    assert doubled() == (3.0, [])
    (data, index), content = files(), [file.read_bytes() for file in files()]
    for file, text in zip((data, index), content, strict=True):
        for damaged in (b"", text[: len(text) // 2], bytes(len(text)), b"\x80\x04NG."):
            file.write_bytes(damaged)
            value, (warning,) = doubled()
            assert value == 3.0
            assert str(tmp_path) in str(warning.message)
            assert doubled() == (3.0, [])


def test_a_cache_that_cannot_be_read_or_written_is_not_needed(
    tmp_path, doubled, monkeypatch
) -> None:
    doubled()
    for file in tmp_path.rglob("*.nbi"):
        file.unlink()
        file.mkdir()  # the tests may run as root, for whom every file can be read and written
    value, (warning,) = doubled()
    assert value == 3.0
    assert "IsADirectoryError" in str(warning.message)
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    value, (warning,) = doubled()
    assert value == 3.0
    assert "no locator available" in str(warning.message)
