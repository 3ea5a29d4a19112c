"""Policies of the Hugging Face hub, from its cache: nothing here uses the network."""

import shutil
from pathlib import Path

import pytest

import aslip
from aslip.base.assets import asset_path
from aslip.errors import AssetError, FileDamagedError
from aslip.policy.hub import hub_file
from tests.contracts.archives import Program, programs

COMMIT = "0123456789" * 4


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files of `owner/walker` in the hub's cache."""
    constants = pytest.importorskip("huggingface_hub.constants")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    hub_file.cache_clear()
    folder = tmp_path / "models--owner--walker"
    for name in ("main", "v1"):
        (folder / "refs").mkdir(parents=True, exist_ok=True)
        (folder / "refs" / name).write_text(COMMIT)
    files = folder / "snapshots" / COMMIT
    files.mkdir(parents=True)
    shutil.copy(asset_path("policies/straight.zip"), files / "policy.zip")
    return files


def test_policy_of_the_hub_is_loaded(repository: Path) -> None:
    expected = aslip.load_policy("straight").state_dict()
    for name in ("hf://owner/walker", "hf://owner/walker@v1", f"hf://owner/walker@{COMMIT}"):
        loaded = aslip.load_policy(name).state_dict()
        assert all(loaded[key].equal(value) for key, value in expected.items())


@pytest.mark.parametrize("name", ["hf://owner/other", "hf://owner/walker@v2", "hf://a/b/c"])
def test_policy_that_cannot_be_had_is_named(repository: Path, name: str) -> None:
    with pytest.raises(AssetError, match=rf"{name}' on the Hugging Face hub: \w+"):
        aslip.load_policy(name)


def test_no_program_in_a_policy_of_the_hub_runs(repository: Path, tmp_path: Path) -> None:
    file, mark = repository / "policy.zip", tmp_path / "ran"
    for content in programs(file.read_bytes(), Program(mark)):
        file.write_bytes(content)
        try:
            aslip.load_policy("hf://owner/walker")
        except FileDamagedError:
            continue
    assert not mark.exists()
