"""A training in all directions runs from a library's file to walks over its region."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

import aslip
from aslip.control import Controller
from aslip.envs import directions_stack, walking_stack
from aslip.errors import ConfigurationError
from aslip.policy import policy_stack, read_card
from aslip.sim import DYNAMICS
from aslip.transforms import COMMAND_RATES, WIDE_RANGES, Difficulty
from aslip.walking import WalkResult
from recipes import ppo_directions
from recipes.ppo_directions import DirectionConfig
from recipes.ppo_settings import training_settings
from tests.helpers import TINY
from tests.library.bent import symmetric_library
from tests.library.standing import slower_library, standing_library


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> DirectionConfig:
    """Settings of two updates with pushes all the time, on a library of eight gaits."""
    folder = tmp_path_factory.mktemp("runs")
    symmetric_library().save(folder / "gaits.npz")
    own = {"out": folder / "tiny", "library": str(folder / "gaits.npz"), "push_interval": 0.03}
    return DirectionConfig(**{**vars(TINY), **own}, stand=0.0)


@pytest.fixture(scope="module")
def results(config: DirectionConfig) -> list[WalkResult]:
    return ppo_directions.main(config)


def test_a_run_walks_commands_all_over_the_region(
    config: DirectionConfig, results: list[WalkResult]
) -> None:
    commands = torch.tensor([[r.speed, r.sideways_speed, r.yaw_rate] for r in results])
    assert len(commands) == 32
    assert (commands.amin(0) < torch.tensor([0.1, -0.1, -0.5])).all()
    assert (commands.amax(0) > torch.tensor([0.6, 0.1, 0.5])).all()
    with (config.out / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["64", "128"]
    assert 0 < float(rows[-1]["term_path_diff"]) <= 1


def test_a_resumed_run_goes_on_with_the_critics_normaliser(
    config: DirectionConfig, results: list[WalkResult]
) -> None:
    longer = replace(config, resume=True, total_steps=192)
    ppo_directions.main(longer)
    assert "192" in (config.out / "summary.md").read_text()
    with pytest.raises(ConfigurationError, match="push_impulse was 30"):
        ppo_directions.main(replace(longer, push_impulse=20.0))


def test_the_policys_file_says_how_fast_its_command_may_change(
    config: DirectionConfig, results: list[WalkResult]
) -> None:
    library = symmetric_library()
    assert policy_stack(config.out) == "walking"
    assert read_card(config.out)["command_rates"] == COMMAND_RATES
    assert Controller(config.out, library).command_rates == COMMAND_RATES
    faster = Controller(config.out, library, command_rates=(3.0, 3.0, 3.0))
    assert faster.command_rates == (3.0, 3.0, 3.0)


def test_only_training_has_other_robots_pushes_and_coarse_physics(config: DirectionConfig) -> None:
    stack = walking_stack(symmetric_library())
    config = replace(config, randomise_share=1.0, command_rates=3.0)
    trained = ppo_directions.training_stack(config, stack)
    fast = tuple(3.0 * rate for rate in COMMAND_RATES)
    assert stack["command_filter"].rates == COMMAND_RATES  # pyright: ignore[reportAttributeAccessIssue]
    assert trained["command_filter"].rates == fast  # pyright: ignore[reportAttributeAccessIssue]
    extra = {"difficulty", "dynamics", "encoders", "pushes", "privileged"}
    assert set(trained) - set(stack) == extra
    env = aslip.make_env(stack=trained, num_envs=2, num_threads=1, timestep=1e-3, seed=0)
    td = env.reset()
    # 16 numbers of the truth, and the parameters
    assert td["privileged"].shape == (2, 16 + len(WIDE_RANGES))
    # half of 128 policy steps of eight robots
    assert next(t for t in env.transforms if isinstance(t, Difficulty)).ramp == 8
    assert all(td["dynamics", name][0] == DYNAMICS[name].nominal for name in WIDE_RANGES)
    hard = env.reset(TensorDict(difficulty=torch.ones(2, 1), batch_size=2))
    for name, (low, high) in WIDE_RANGES.items():
        assert low <= float(hard["dynamics", name][0]) <= high
        assert hard["dynamics", name][0] != hard["dynamics", name][1]
    assert not td["motor_offset"].any()
    assert 0 < hard["motor_offset"].abs().max() <= 0.01
    assert env.base_env.model.opt.timestep == 1e-3
    whole = ppo_directions.training_stack(replace(config, ramp=0.0), stack)
    assert "difficulty" not in whole
    nominal = replace(config, ramp=0.0, randomise=False, push_impulse=0.0, privileged=False)
    same = ppo_directions.training_stack(nominal, stack)
    assert [*same] == [*stack]
    assert {name for name in stack if same[name] != stack[name]} == {"command_filter"}


def test_episodes_of_a_training_have_ever_more_different_robots(config: DirectionConfig) -> None:
    """Until they have the full ranges, of about a third of the parameters each."""
    trained = ppo_directions.training_stack(config, walking_stack(symmetric_library()))
    env = aslip.make_env(stack=trained, num_envs=16, num_threads=1, timestep=1e-3, seed=0)
    td, action = env.reset(), 3.0 * torch.randn(16, 10, generator=torch.manual_seed(0))
    for _ in range(60):  # robots fall, and their next episodes begin
        _, td = env.step_and_maybe_reset(td.set("action", action))
    assert (td["difficulty"] == 1).all()
    names = [name for name in WIDE_RANGES if name != "torque_delay"]
    differs = torch.cat([td["dynamics", n] != DYNAMICS[n].nominal for n in names], dim=-1)
    assert 0.15 < differs.float().mean() < 0.45
    assert td["dynamics", "payload"].max() > 8.0


def test_settings_of_a_run_are_kept_when_it_is_resumed(
    config: DirectionConfig, results: list[WalkResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--resume", "--out", str(config.out)]
    kept = training_settings({"default": DirectionConfig()}, words)
    assert kept.library == config.library
    assert kept.push_interval == 0.03
    for name, value in {
        "push_impulse": -1.0,
        "push_interval": 0.0,
        "stand": 1.5,
        "ramp": -0.1,
    }.items():
        with pytest.raises(ConfigurationError, match=f"{name} must be .*, got {value}"):
            replace(config, **{name: value})


def test_robots_learn_to_stand_if_the_library_has_stop_and_start(
    config: DirectionConfig, tmp_path: Path
) -> None:
    file = tmp_path / "gaits.npz"
    standing_library().save(file)
    stands = replace(config, stand=1.0, library=str(file), out=tmp_path / "run", total_steps=64)
    ppo_directions.main(stands)
    assert policy_stack(stands.out) == "directions"
    assert Controller(stands.out, standing_library()).steering.stands
    trained = ppo_directions.training_stack(stands, directions_stack(standing_library()))
    assert aslip.make_env(stack=trained, num_envs=8, num_threads=1, seed=0).reset()["stand"].all()
    with pytest.raises(ConfigurationError, match="needs a library with stop and start"):
        ppo_directions.main(replace(config, stand=0.1))
    slower_library().save(file)
    with pytest.raises(ConfigurationError, match=f"reference was .*{slower_library().sha256[:12]}"):
        ppo_directions.main(replace(stands, resume=True, total_steps=128))
