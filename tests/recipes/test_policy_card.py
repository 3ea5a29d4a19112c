"""The card of a shipped policy agrees with the policy file and its measurements."""

import json
import re
import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import numpy as np
import pytest
import torch

import aslip
import aslip.base.provenance
from aslip.base.assets import asset_path
from aslip.base.provenance import provenance
from aslip.envs import default_stack, describe_transforms, randomise_stack
from aslip.errors import AssetError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, read_card, save_policy
from aslip.transforms import DIRECTION_TABLE, OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE
from recipes import policy_card
from recipes.policy_card import Config
from recipes.ppo_settings import PRESETS
from tests.helpers import TINY
from tests.training.trainings import train


def _card(run_folder: Path | None, assets: Path, **settings: Any) -> str:
    config = Config("mine", run_folder, assets, assets / "out", **{"measure": False, **settings})
    return policy_card.main(config).read_text()


SIZES = {"single_reference": 49, "directions": 82}


def _saved(folder: Path, stack: str, table: tuple, made_by: dict | None = None) -> Path:
    size = SIZES.get(stack, 64)
    actor = make_actor(RunningNormalizer(size), PolicyShape(size), table)
    folder.mkdir()
    key = "motor_target" if stack in ("straight", "directions") else "motor_position"
    names = {"stack": stack, "observation": list(table), "baseline": ("reference", key)}
    save_policy(folder / "policy.zip", actor, PolicyShape(size), made_by, **names)
    return folder


@pytest.mark.parametrize(
    ("stack", "table", "baseline"),
    [
        ("straight", OBSERVATION_TABLE, "reference/motor_target"),
        ("single_reference", SINGLE_REFERENCE_TABLE, "reference/motor_position"),
        ("directions", DIRECTION_TABLE, "reference/motor_target"),
    ],
)
def test_card_lists_interface_of_stack(
    tmp_path: Path, stack: str, table: tuple, baseline: str
) -> None:
    text = _card(_saved(tmp_path / "run", stack, table), tmp_path / "assets")
    rows = re.findall(r"^\| (\d+)(?:-(\d+))? \| (\S+) \|", text, re.MULTILINE)
    ends = [int(last or first) for first, last, _ in rows]
    size = SIZES.get(stack, 64)
    assert [int(first) for first, *_ in rows] == [0, *(end + 1 for end in ends[:-1])]
    assert ends[-1] == size - 1
    assert [name for *_, name in rows] == [
        name if isinstance(name, str) else "/".join(name) for name in table
    ]
    assert f"It observes {size} numbers" in text
    assert baseline in text
    assert "| left_knee | 96 | 9.6 | 195.2 |" in text


def test_card_lists_training(tmp_path: Path) -> None:
    config = replace(TINY, out=tmp_path / "run", total_steps=64)
    train(config)
    text = _card(config.out, tmp_path / "assets")
    made = read_card(config.out / "policy.zip")["made_by"]
    assert made["commit"] == provenance()["commit"]
    assert f"| commit | {made['commit'] or 'not recorded'} |" in text
    assert f"mujoco {made['versions']['mujoco']}" in text
    assert "| policy steps | 64 |" in text
    assert "num_envs 8" in text
    assert "![Learning curve](mine.png)" in text
    assert (tmp_path / "assets" / "mine.png").read_bytes().startswith(b"\x89PNG")
    aslip.load_policy(tmp_path / "assets" / "mine.zip")


def test_card_of_shipped_policy_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equal to the one written when it was shipped, with measurements of today."""
    monkeypatch.setattr(policy_card, "evaluate", lambda *_: [])
    monkeypatch.setattr(policy_card, "walk_table", lambda _: "| walks |\n\nof 2 speeds 1 survived")
    monkeypatch.setattr(policy_card, "benchmark_sections", lambda *_: ["## Benchmarks"])
    made_by = {"settings": {"seed": 3}}
    folder = _saved(tmp_path / "run", "straight", OBSERVATION_TABLE, made_by)
    first = _card(folder, tmp_path / "assets", measure=True)
    shutil.rmtree(folder)
    weights = (tmp_path / "assets" / "mine.zip").read_bytes()
    assert _card(None, tmp_path / "assets", measure=True) == first
    assert (tmp_path / "assets" / "mine.zip").read_bytes() == weights
    assert f"measured with commit {provenance()['commit'] or 'not recorded'}." in first
    assert "on the nominal robot: of 2 speeds 1 survived.\n\n| walks |\n\n## Benchmarks" in first


def test_refuses_missing_run_and_invalid_name(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="neither a file"):
        _card(tmp_path / "nothing", tmp_path / "assets")
    with pytest.raises(AssetError, match="mine"):
        _card(None, tmp_path / "assets")
    with pytest.raises(ConfigurationError, match=r"\.\./mine"):
        Config("../mine", tmp_path)


def test_policy_and_card_are_uploaded_in_one_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a new repository that is private; the card has front matter and how to load the policy."""
    api = pytest.importorskip("huggingface_hub").HfApi
    create, commit = (create_autospec(f) for f in (api.create_repo, api.create_commit))
    monkeypatch.setattr(api, "create_repo", create)
    monkeypatch.setattr(api, "create_commit", commit)
    folder = _saved(tmp_path / "run", "straight", OBSERVATION_TABLE)
    (folder / "learning_curve.png").write_bytes(b"a picture")
    text = _card(folder, tmp_path / "assets", hub="owner/mine")
    assert create.call_args.args[1:] == ("owner/mine",)
    assert create.call_args.kwargs == {"private": True, "exist_ok": True}
    _, name, added = commit.call_args.args
    files = {one.path_in_repo: one.path_or_fileobj for one in added}
    assert name == "owner/mine"
    assert files["policy.zip"] == (tmp_path / "assets" / "mine.zip").read_bytes()
    assert files["mine.png"] == b"a picture"
    _, front, card = files["README.md"].decode().split("---\n", 2)
    assert {"library_name: aslip", "- robotics"} <= {*front.splitlines()}
    assert card.strip().startswith(text.strip())
    assert 'aslip.load_policy("hf://owner/mine")' in card


def test_limits_on_the_card_are_the_worst_measurements() -> None:
    cells = [{"phase": 0.0, "mean": 9.0}, {"phase": 0.5, "mean": 4.0}]
    sweep = {"parameter": "payload", "falls": []}
    numbers = {
        "speed": 1.0,
        "push_duration": 0.21,
        "pushes": [
            {"direction_deg": 0.0, "phases": cells[:1]},
            {"direction_deg": 90.0, "phases": cells},
        ],
        "sweeps": [
            {**sweep, "value": 0.0, "mean": 1.0},
            {**sweep, "value": 8.0, "mean": 0.5},
            {**sweep, "parameter": "slope", "value": -3.0, "mean": 1.0},
            {**sweep, "parameter": "slope", "value": 3.0, "mean": 1.0},
        ],
    }
    text = policy_card.limits(numbers)
    assert "of more than 4.0 N s, where it is weakest: at phase 0.5, at 90°" in text
    assert "payload [kg]: some walks fail at 8." in text
    assert "slope [deg]: none from -3 to 3." in text


def test_run_folder_is_removed_from_shipped_policy(tmp_path: Path) -> None:
    command = "python recipes/ppo_aslip.py --out ../runs/mine --seed 3 --resume"
    folder = _saved(tmp_path / "run", "straight", OBSERVATION_TABLE, {"command": command})
    text = _card(folder, tmp_path / "assets")
    assert "`python recipes/ppo_aslip.py --seed 3`" in text
    files = folder / "policy.zip", tmp_path / "assets" / "mine.zip"
    old, new = (read_card(file) for file in files)
    assert new["made_by"].pop("command") == "python recipes/ppo_aslip.py --seed 3"
    assert old["made_by"].pop("command") == command
    assert new == old
    weights = [aslip.load_policy(file).state_dict() for file in files]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_policy_that_follows_other_gaits_still_names_those_of_its_training(tmp_path: Path) -> None:
    """Also if it is moved twice; its weights stay."""
    folder = _saved(tmp_path / "run", "straight", OBSERVATION_TABLE)
    assets, file = tmp_path / "assets", tmp_path / "assets" / "mine.zip"
    _card(folder, assets, library="single_reference")
    text = _card(None, assets, library="gaits")
    first, now = (GaitLibrary.load(name).sha256 for name in ("single_reference", "gaits"))
    card = read_card(file)
    assert card["library_sha256"] == now
    assert card["made_by"] == {"trained_on": first}
    assert f"SHA-256 {first[:12]}, follows those of {now[:12]}" in text
    weights = [aslip.load_policy(path).state_dict() for path in (folder / "policy.zip", file)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_card_names_the_policy_that_acts_without_stones() -> None:
    """The one from which the training started, unless the file names another."""
    about = read_card("stones")
    assert "| without stones | the network of `directions`," in policy_card.training_section(about)
    del about["made_by"]["gaits"]
    start = about["made_by"]["settings"]["start"]
    assert f"| without stones | the network of `{start}`," in policy_card.training_section(about)
    assert "without stones" not in policy_card.training_section(read_card("directions"))


def test_card_lists_training_conditions() -> None:
    """Ranges, share and pushes on the card are those of the policy's file, not today's defaults."""
    made: dict[str, dict] = {"settings": {}}
    line = policy_card.training_conditions({"made_by": made})
    assert line.endswith("level ground with friction 1, to walk straight ahead.")
    stack = randomise_stack(default_stack(), {"payload": (0.0, 7.5), "sensor_noise": (0.5, 1.5)})
    made["transforms"] = describe_transforms(aslip.make_env(stack=stack, seed=0))
    line = policy_card.training_conditions({"made_by": made})
    assert "drawn for each episode: payload 0 to 7.5, sensor_noise 0.5 to 1.5; see" in line
    settings = {"randomise_share": 0.3, "ramp": 0.5, "push_impulse": 30.0, "encoder_offset": 0.01}
    made["settings"] |= settings
    line = policy_card.training_conditions({"made_by": made})
    assert "(each nominal with a probability of 0.7), in ranges that grew from" in line
    assert "1.5, encoder offsets of up to 0.01 rad; see" in line
    assert line.endswith(", with pushes of up to 30 N s.")


def test_card_of_walks_in_all_directions_has_the_targets_and_their_benchmarks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("tracking", "command_changes", "stops", "figure_of_eight", "foot_placement")
    limits = {"speed": 1.0, "push_duration": 0.2, "sweeps": [], "pushes": []}
    limits["pushes"] = [{"direction_deg": 0.0, "phases": [{"phase": 0.0, "mean": 30.0}]}]

    def measured(config: policy_card.direction_targets.Config) -> list[dict[str, Any]]:
        folder = config.out / "mine"
        folder.mkdir(parents=True)
        for name in (*names, "walking_quality", "pushes"):
            (folder / f"{name}.md").write_text(f"table of {name}")
        (folder / "pushes.json").write_text(json.dumps(limits))
        (config.out / "direction_targets.md").write_text("table of targets")
        return []

    monkeypatch.setattr(policy_card.direction_targets, "main", measured)
    made = {"transforms": {"training/dynamics": "RandomDynamics()"}}
    about = {"observation": ["filtered_command"], "made_by": made}
    shutil.copy(asset_path("policies/straight.zip"), tmp_path / "mine.zip")
    config = Config("mine", assets=tmp_path, out=tmp_path / "out")
    text = "\n".join(policy_card.benchmark_sections(config, str(tmp_path / "mine.zip"), about))
    for name in (*names, "walking_quality", "pushes", "targets"):
        assert f"table of {name}" in text
    assert text.count("aslip measure scorecard.direction_targets --policy mine") == 1
    assert text.count("aslip measure") == 1  # as other commands have other settings
    assert "pushes of 0.2 s of more than 30.0 N s" in text
    assert "It was trained to walk in all directions on robots" in text


def test_provenance_names_the_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a plus if files other than documents have changed; None outside a checkout."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    monkeypatch.setattr(
        aslip.base.provenance,
        "__file__",
        str(tmp_path / "aslip" / "training" / "provenance.py"),
    )
    assert provenance()["commit"] is None
    (tmp_path / "docs").mkdir()
    file, *documents = (tmp_path / name for name in ("file", "docs/record.csv", "README.md"))
    for path in (file, *documents):
        path.write_text("one")
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "one"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    commit = provenance()["commit"]
    assert re.fullmatch("[0-9a-f]{12}", commit)
    for path in documents:
        path.write_text("two")
    assert provenance()["commit"] == commit
    file.write_text("two")
    assert provenance()["commit"] == f"{commit}+"
    assert json.dumps(provenance())
    assert np.all([provenance()["versions"][name] for name in ("torch", "mujoco")])


@pytest.mark.parametrize("name", ["straight", "robust", "single_reference"])
def test_shipped_policies_have_the_settings_of_their_presets(name: str) -> None:
    made = read_card(name)["made_by"]["settings"]
    expected = asdict(PRESETS[name])
    learning = (made.keys() & expected.keys()) - {
        "preset",
        "seed",
        "schedule_steps",
        "num_collectors",
    }
    assert len(learning) > 15
    assert {key for key in learning if made[key] != expected[key]} == set()
