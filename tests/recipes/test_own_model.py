"""Page on a model of one's own, from the model to its measurement."""

import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import walk
from ppo_presets import environments

import aslip
from aslip.base.command_line import command_line, preset_command_line
from aslip.errors import ConfigurationError
from aslip.network.runner.load import load
from aslip.policy import policy_environment, policy_library, read_card
from aslip.walking import Walker
from benchmarks import common
from benchmarks.paper import ground_force, velocity_tracking
from benchmarks.robustness import walking_quality
from recipes import policy_card, ppo_aslip
from tests.helpers import TINY
from tests.test_docs import DOCS, blocks, commands

PAGE = (DOCS / "own_model.md").read_text()
SHORT: dict[str, Any] = {"settle": 0.06, "walk": 0.12}


def words_of(program: str) -> list[str]:
    """Arguments of the first command of the page that runs a program."""
    return next(words[i + 1 :] for words in commands(PAGE) for i in (1, 2) if words[i] == program)


def test_an_own_model_is_trained_walked_watched_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for module in (common, ppo_aslip):  # files of pictures take two seconds
        monkeypatch.setattr(module, "save_figure", lambda *_: None)
    ((_, code),) = blocks(PAGE, "python")
    Path("glide.py").write_text(code)
    runpy.run_path("glide.py")  # warnings are errors
    settings = preset_command_line(ppo_aslip.PRESETS, {}, words_of("recipes/ppo_aslip.py"))
    config = replace(TINY, library=settings.library, out=settings.out, samples=16, total_steps=32)
    ppo_aslip.main(config, **environments(config))
    gaits = aslip.GaitLibrary.load("glide.npz")
    Path("glide.npz").unlink()

    folder = settings.out
    card, made = read_card(folder), policy_environment(folder)
    assert (card["stack"], card["library_sha256"]) == ("straight", gaits.sha256)
    assert (made["library"].name, made["library"].sha256) == (f"{folder}/library.npz", gaits.sha256)
    assert load(folder).controller.command_size == 1

    walking = command_line(walk.Config, arguments=words_of("recipes/walk.py"))
    walk.main(replace(walking, duration=0.09))
    assert "walked for 0.09 s" in capsys.readouterr().out
    served: list[Walker] = []
    monkeypatch.setattr(walk, "serve", lambda config, walker: served.append(walker))
    walk.main(replace(walking, live=True, command="0.5", log=None))
    assert served[0].library.sha256 == gaits.sha256

    settings_of: dict[str, Any] = {"policy": (str(folder),), "speeds": (0.5,)}
    found = velocity_tracking.main(
        velocity_tracking.Config(**settings_of, **SHORT, hold=0.15, transient=0.03)
    )
    assert found["map"][0]["command"] == 0.5
    of_both = {**settings_of, "policy": (f"glide={folder}", "spring=straight")}
    rows = ground_force.main(ground_force.Config(**of_both, **SHORT))
    assert [row["method"] for row in rows] == ["glide", "spring", "model"]
    assert rows[-1]["peak"] == pytest.approx(326.8, abs=0.1)  # the model never has two humps
    quality = walking_quality.main(walking_quality.Config(**of_both, **SHORT))
    assert {row["method"] for row in quality} >= {"glide", "spring"}

    card = policy_card.Config(name="mine", run=folder, assets=Path("assets"), measure=False)
    policy_card.main(card)
    assert policy_library("assets/mine.zip").name == "assets/mine.npz"

    other = "runs/glide/other.npz"
    aslip.GaitLibrary.load("single_reference").save(other)
    refused = (
        rf"'runs/glide' follows other gaits, those of 'glide.npz'.*{gaits.sha256[:12]}.*'{other}'"
    )
    with pytest.raises(ConfigurationError, match=refused):
        walk.main(replace(walking, library=other))
