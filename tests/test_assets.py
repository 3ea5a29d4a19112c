"""Shipped files are found; missing ones are named."""

from __future__ import annotations

import pytest

from aslip.assets import asset_path
from aslip.errors import AslipError, AssetError


def test_shipped_files_are_found() -> None:
    assert asset_path("cassie.xml").is_file()
    assert asset_path("gaits.npz").is_file()


def test_a_missing_asset_lists_what_there_is() -> None:
    with pytest.raises(AssetError, match=r"no asset 'casie\.xml'.*cassie\.xml") as info:
        asset_path("casie.xml")
    assert isinstance(info.value, FileNotFoundError)
    assert isinstance(info.value, AslipError)
