"""Shipped files are found; missing ones are named."""

import importlib.util
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import aslip.base.assets
from aslip.base.assets import asset_path
from aslip.errors import AslipError, AssetError
from aslip.library import GaitFolder, GaitLibrary
from aslip.log import Recorder, read, recover
from aslip.network.runner.load import load
from aslip.policy import find_policy
from aslip.robot import CASSIE
from aslip.show.plots import save_figure
from aslip.training.run import TrainingRun
from benchmarks.flags import Common
from recipes.ppo_settings import Config


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
    (package / "base").mkdir()
    copy = shutil.copy(aslip.base.assets.__file__, package / "base")
    spec = importlib.util.spec_from_file_location("installed_assets", copy)
    assert spec is not None
    assert spec.loader is not None
    installed = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(installed)
    assert installed.asset_path("own.txt").read_text() == "ours"


# --------------------------------------------------------------- paths that users name


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Home folder, which is not the working folder."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def test_files_are_read_from_the_home_folder(home: Path) -> None:
    shutil.copy(asset_path("policies/straight.zip"), home / "p.zip")
    assert find_policy("~/p.zip") == find_policy(Path("~/p.zip")) == home / "p.zip"
    shutil.copy(asset_path("gaits.npz"), home / "g.npz")
    assert len(GaitLibrary.load("~/g.npz").speeds) == 21
    assert replace(CASSIE, model_file=Path("~/m.xml")).mjcf == home / "m.xml"
    for function in (read, recover):
        with pytest.raises(AssetError, match=re.escape(f"'{home}/w.mcap'")):
            function("~/w.mcap")
    with pytest.raises(AssetError, match=re.escape(f"'{home}/p.onnx'")):
        load("~/p.onnx")


def test_files_are_written_to_the_home_folder(home: Path, library: GaitLibrary) -> None:
    library.save("~/new.npz")
    save_figure(Figure(), Path("~/pictures/a.png"))
    config = Config(out=Path("~/run"))
    TrainingRun(Path("~/again"), config, resume=False)
    TrainingRun(config.out, config, resume=False)
    assert GaitFolder(Path("~/gaits")).folder == home / "gaits"
    assert Recorder("~/w.mcap").path == home / "w.mcap"
    assert Common(out=Path("~/b")).out == home / "b"
    names = {path.name for path in home.iterdir()}
    assert names == {"elsewhere", "new.npz", "pictures", "run", "again"}
    assert not [*Path.cwd().iterdir()]
