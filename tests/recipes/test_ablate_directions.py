"""Ablations of walks in all directions."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import ablate
import ablate_directions
import pytest
import torch
from ablate_directions import VARIANTS
from ablate_settings import TASKS
from ppo_directions import DirectionConfig

import aslip
from aslip.errors import AssetError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.transforms.rewards import DIRECTION_WEIGHTS
from tests.library.standing import standing_library


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("library") / "gaits.npz"
    standing_library().save(file)
    return file


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """Small updates and short walks, without pictures."""
    settings = {"samples": 16, "minibatch": 8, "eval_steps": 2}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ablate_directions, "DirectionConfig", partial(DirectionConfig, **settings))
        patch.setattr(ablate_directions, "MAX_EPISODE_STEPS", 2)
        patch.setattr("aslip.training.environments.DIRECTIONS", 2)
        patch.setattr(ablate_directions.ppo_directions.ppo_aslip, "save_figure", lambda *_: None)
        yield


@pytest.mark.parametrize(
    "names", [("no_effort", "memory"), pytest.param((*VARIANTS,), marks=pytest.mark.slow)]
)
def test_variants_train_and_walk(library: Path, tmp_path: Path, names: tuple[str, ...]) -> None:
    """Each walks the commands on the nominal robot, then on drawn ones."""
    small = {"variants": names, "total_steps": 16, "num_envs": 2, "out": tmp_path}
    config = replace(TASKS["directions"], **small, library=str(library))
    found = ablate.main(config)
    assert list(found) == [*names]
    for walks in found.values():
        assert len(walks[0]) == 4
        assert {*walks[0][0].terms} == {*DIRECTION_WEIGHTS}
    shown = (tmp_path / "ablation.md").read_text()
    assert shown.count("Counts are of 2 commands") == 2
    halves = [part.splitlines() for part in shown.split("## Drawn robots")]
    for name in names:
        nominal, drawn = (next(x for x in part if f"| {name} |" in x) for part in halves)
        assert nominal != drawn
    other = library.with_name("other.npz")
    usual = standing_library()
    table = replace(usual.table, motor_torque=2 * usual.table.motor_torque)
    GaitLibrary(usual.motions, table, transitions=usual.transitions).save(other)
    with pytest.raises(ConfigurationError, match=r"had .*library_sha256.* choose another --out"):
        ablate.main(replace(config, library=str(other)))
    with pytest.raises(AssetError, match="nowhere"):
        ablate.main(replace(config, library="nowhere.npz"))


@pytest.mark.parametrize("heading", [0.5, 4.0])
def test_the_world_frame_does_not_turn_with_the_path(heading: float) -> None:
    library = standing_library()
    env = aslip.make_env(stack=ablate_directions.in_world_frame(library), num_threads=1, seed=0)
    td = env.reset()
    td["heading"] = torch.full((1, 1), heading)
    td["action"] = torch.zeros(1, 10)
    td = env.step(td)["next"]
    turn, seen = float(td["heading"]), td["observation"]
    half = torch.tensor([[turn / 2]])
    turned = aslip.transforms.rotation.multiply(
        torch.cat([half.cos(), 0 * half, 0 * half, half.sin()], -1), td["estimate", "orientation"]
    )
    # a pose has one quaternion
    torch.testing.assert_close(seen[:, 1:5], turned * turned[:, :1].sign())
    torch.testing.assert_close(
        seen[:, -2:], torch.cat([td["heading"].cos(), td["heading"].sin()], -1)
    )
    assert (seen[:, 1:5] - td["estimate", "orientation"]).abs().max() > 0.1
    assert torch.equal(seen[:, 8:11], td["estimate", "angular_velocity"])


def test_independent_gaits_are_those_of_the_library() -> None:
    library = standing_library()
    env = aslip.make_env(
        stack=ablate_directions.with_independent_gaits(library), num_threads=1, seed=0
    )
    td = env.reset()
    table = library.table
    commands = torch.from_numpy(table.commands[~table.missing]).float()
    assert (commands == td["gait_command"]).all(-1).any()
    found = library.lookup(td["phase"], td["gait_command"], td["mode"])
    assert torch.equal(td["reference", "body_position"], found.body_position)
