"""Shipped files are found; missing ones are named."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import pytest

import aslip.files.assets
from aslip.errors import AslipError, AssetError
from aslip.files.assets import asset_path


def test_shipped_files_are_found() -> None:
    assert asset_path("cassie.xml").is_file()
    assert asset_path("gaits.npz").is_file()


def test_missing_asset_lists_the_shipped_files() -> None:
    with pytest.raises(AssetError, match=r"no asset 'casie\.xml'.*cassie\.xml") as info:
        asset_path("casie.xml")
    assert isinstance(info.value, FileNotFoundError)
    assert isinstance(info.value, AslipError)


def test_installed_package_finds_its_own_files(tmp_path: Path) -> None:
    """Another package may have left a pyproject.toml and assets in site-packages."""
    package = tmp_path / "aslip"
    (package / "_assets").mkdir(parents=True)
    (package / "_assets" / "own.txt").write_text("ours")
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "own.txt").write_text("another's")
    (tmp_path / "pyproject.toml").touch()
    (package / "files").mkdir()
    copy = shutil.copy(aslip.files.assets.__file__, package / "files")
    spec = importlib.util.spec_from_file_location("installed_assets", copy)
    assert spec is not None
    assert spec.loader is not None
    installed = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(installed)
    assert installed.asset_path("own.txt").read_text() == "ours"
