"""The PPO recipe trains from end to end, resumes, and accepts custom parts."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite
from torchrl.envs.transforms import StepCounter, Transform
from torchrl.record.loggers import CSVLogger

import aslip
from aslip.errors import AslipError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import make_recurrent_actor, policy_stack, read_card
from aslip.training.environments import make_training_env
from aslip.training.progress import Progress
from aslip.training.run import TrainingStoppedError
from aslip.transforms import (
    OBSERVATION_TABLE,
    AssembleObservation,
    ObservationNoise,
    RandomNoise,
    RewardTerm,
    SeededTransform,
    SpeedCommand,
    TrueState,
    WeightedReward,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import Walker, WalkResult
from recipes import ppo_aslip
from recipes.ppo_presets import environments
from recipes.ppo_settings import PRESETS, scheduled, with_schedule
from tests.helpers import TINY


def _rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "progress.csv").open(newline="") as file:
        return list(csv.DictReader(file))


Run = tuple[Path, list[WalkResult], str]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run of two updates: folder, final evaluation, and output."""
    folder, out = tmp_path_factory.mktemp("runs") / "tiny", io.StringIO()
    logger = CSVLogger("own", str(folder.with_name("logs")))
    with contextlib.redirect_stdout(out):
        results = ppo_aslip.main(replace(TINY, out=folder, total_steps=70), logger=logger)
    return folder, results, out.getvalue()


def test_a_run_writes_all_its_files(run: Run) -> None:
    folder, results, _ = run
    for name in ("config.json", "progress.csv", "policy.zip", "summary.md", "learning_curve.png"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").iterdir())
    assert len(list((folder / "checkpoints").glob("*.zip"))) == 2
    assert not list(folder.rglob("*.part"))
    assert (folder.with_name("logs") / "own/scalars/episode_return.csv").exists()
    assert [round(r.speed, 3) for r in results] == [round(0.1 * i, 3) for i in range(21)]
    for result in results:
        assert 1 <= result.steps <= TINY.eval_steps
        assert 0 < result.total <= result.steps
        assert all(0 <= value <= 1 for value in result.terms.values())


def test_progress_has_one_row_per_update(run: Run) -> None:
    rows = _rows(run[0])
    assert [row["step"] for row in rows] == ["64", "128"]
    for row in rows:
        assert all(row.values())
        for term in PAPER_WEIGHTS:
            assert 0 <= float(row[f"term_{term}"]) <= 1
    assert float(rows[-1]["eval_return"]) > 0


def test_messages_name_folder_length_and_how_to_resume(run: Run) -> None:
    folder, _, out = run
    first, second, *_ = out.splitlines()
    assert first == (
        f"{folder}: training for 128 policy steps (70, rounded up to updates of 64);"
        " preset default, seed 0, 8 robots"
    )
    assert second == "Ctrl-C saves and stops; to continue: resume=True"
    lines = (folder / "summary.md").read_text().splitlines()
    assert sum(line.startswith("| ") for line in lines) == 23
    assert "of 21 speeds" in "\n".join(lines)
    assert "128 policy steps" in lines[-1]


def test_the_policy_of_a_run_can_be_loaded(run: Run) -> None:
    policy = aslip.load_policy(run[0])
    assert policy(aslip.make_env(num_threads=1).reset())["action"].shape == (1, 10)
    assert policy_stack(run[0]) == "aslip"


def test_another_run_in_the_same_folder_is_refused(run: Run) -> None:
    with pytest.raises(ConfigurationError, match="holds a run already"):
        ppo_aslip.main(replace(TINY, out=run[0]))
    with pytest.raises(ConfigurationError, match="seed was 0 and is 1"):
        ppo_aslip.main(replace(TINY, out=run[0], resume=True, seed=1))


def test_runs_with_the_same_seed_are_equal_with_or_without_evaluations(
    run: Run, tmp_path: Path
) -> None:
    """They are equal to the last digit, except for times and additional evaluations."""
    config = replace(TINY, out=tmp_path / "again", total_steps=70, eval_interval=64)
    assert ppo_aslip.main(config) == run[1]
    first, second = _rows(run[0]), _rows(config.out)
    for row in (*first, *second):
        for name in [name for name in row if name == "elapsed_s" or name.startswith("eval_")]:
            del row[name]
    assert first == second
    a, b = (aslip.load_policy(folder).state_dict() for folder in (run[0], config.out))
    assert all(torch.equal(a[key], b[key]) for key in a)


def test_a_finished_run_resumes_with_its_final_learning_rate(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The policy changes and rows are added; the longer training does not change the schedule."""
    folder, seen, update = run[0], [], ppo_aslip.update

    def spied(data: Any, loss: Any, optimizer: Any, config: Any) -> Any:
        seen.append((optimizer.param_groups[0]["lr"], float(data["scale"][0, 0, 0])))
        return update(data, loss, optimizer, config)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    before, weights = _rows(folder), aslip.load_policy(folder).state_dict()
    longer = replace(TINY, out=folder, resume=True, total_steps=192)
    ppo_aslip.main(longer)
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith(f"{folder}: continuing after 128 of 192 policy steps; preset default")
    assert first.endswith("; total_steps 70 -> 192")
    assert seen == [pytest.approx((TINY.last_learning_rate, TINY.last_std))]
    after = _rows(folder)
    assert [row["step"] for row in after] == ["64", "128", "192"]
    assert after[:2] == before
    assert float(after[2]["elapsed_s"]) > float(before[1]["elapsed_s"])
    resumed = aslip.load_policy(folder).state_dict()
    assert any(not torch.equal(weights[key], resumed[key]) for key in weights if "weight" in key)
    assert all(resumed[key] == weights[key] + 64 for key in weights if key.endswith("count"))
    ppo_aslip.main(longer)
    assert "nothing left to train after 192 of 192" in capsys.readouterr().out


def test_schedules_decay_exponentially_at_the_end() -> None:
    config = replace(TINY, total_steps=256, fall_after=0.5)
    values = [scheduled(config, step, 0.4, 0.1) for step in (0, 128, 192, 256, 512)]
    assert values == pytest.approx([0.4, 0.4, 0.2, 0.1, 0.1])
    kept = {"total_steps": 1000, "schedule_steps": 2000}
    assert with_schedule(replace(TINY, total_steps=3000), kept).schedule_steps == 2000


def test_the_bar_moves_at_each_policy_step_without_changing_actions() -> None:
    actor, progress = torch.nn.Linear(2, 2), Progress(64, 24)
    plain = [actor(torch.ones(2)) for _ in range(6)]
    data = TensorDict(next=TensorDict(truth=TensorDict(diverged=torch.tensor([[True], [False]]))))
    outputs: list[torch.Tensor] = []

    def batches() -> Iterator[Any]:
        for _ in range(2):
            outputs.extend(actor(torch.ones(2)) for _ in range(3))
            yield data

    shown = []
    with progress:
        for _ in progress.watch(batches(), cast("Any", actor), robots=8):
            assert progress._bar is not None
            shown.append(progress._bar.n)
            actor(torch.ones(2))  # evaluations do not move the bar
            progress.step += 24
    assert shown == [24, 48]
    assert progress.total == 72
    assert progress.state()["divergences"] == 2
    torch.testing.assert_close(torch.stack(outputs), torch.stack(plain), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs must be positive, got 0"),
        ({"total_steps": -5}, "total_steps"),
        ({"minibatch": 0}, "minibatch"),
        ({"epochs": 0}, "epochs"),
        ({"samples": 100}, "samples must be a multiple of num_envs = 8, got 100"),
        ({"learning_rate": -1e-4}, "learning_rate"),
        ({"fall_after": 1.0}, "fall_after"),
        ({"gamma": 1.5}, "gamma"),
        ({"eval_interval": 0}, "eval_interval"),
        ({"checkpoint_minutes": -1.0}, "checkpoint_minutes must be 0 or more"),
        ({"seed": -1}, r"seed must be from 0 to 2\*\*63 - 1, got -1"),
        ({"seed": 2**63}, "seed"),
        ({"num_envs": 8.0}, r"num_envs must be an integer, got 8\.0"),
        ({"num_envs": True}, "num_envs must be an integer, got True"),
        ({"learning_rate": float("nan")}, "learning_rate must be a finite number, got nan"),
        ({"gamma": "0.9"}, "gamma must be a finite number, got '0.9'"),
        ({"symmetric": 1}, "symmetric must be True or False, got 1"),
        ({"device": 0}, "device must be a str, got 0"),
        ({"out": "runs"}, "out must be a Path, got 'runs'"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(TINY, **change)


# ----------------------------------------------------------------- environments


def test_presets_set_their_environments() -> None:
    """Only training has staggered ends; the preset sets the interval of commands."""
    found = {}
    for name in PRESETS:
        made = environments(name)
        make_env = made.get("make_env", aslip.make_env)
        train = made.get("make_train_env", partial(make_training_env, make_env))
        envs = [make(num_envs=2, seed=0, num_threads=1) for make in (train, make_env)]
        commands = [next(t for t in e.transforms if isinstance(t, SpeedCommand)) for e in envs]
        found[name] = envs, [command.interval for command in commands]
        assert "StaggeredEnds" in envs[0].transform_names
        assert "StaggeredEnds" not in envs[1].transform_names
    for name, (_, intervals) in found.items():
        one_speed = name in ("paper", "single-reference")
        assert intervals == [math.inf if one_speed else 8.0, math.inf]
    trained, evaluated = found["robust"][0]
    assert trained.reset()["observation"].shape == evaluated.reset()["observation"].shape
    masses = trained.base_env.dynamics["mass"]
    assert masses[0] != masses[1]
    assert (evaluated.base_env.dynamics["mass"] == 1.0).all()
    noise = [
        [type(t) for t in e.transforms if isinstance(t, ObservationNoise)]
        for e in (trained, evaluated)
    ]
    assert noise == [[RandomNoise], [ObservationNoise]]
    steps = [env.base_env.model.opt.timestep for env in found["coarse"][0]]
    assert steps == [0.001, 0.0005]
    for env in found["truth"][0]:
        assert "noise" not in env.transform_names
        assert any(isinstance(t, TrueState) for t in env.transforms)
    assert found["single-reference"][0][0].reset()["observation"].shape[-1] == 49
    assert "feedforward" not in found["paper"][0][1].transform_names


@pytest.mark.parametrize(("own", "trained"), [(20.0, 20.0), (0.3, 0.3), (math.inf, 8.0)])
def test_a_custom_finite_command_interval_is_kept(
    library: GaitLibrary, own: float, trained: float
) -> None:
    command = SpeedCommand(library, interval=own)
    env = make_training_env(aslip.make_env, 8.0, replace={"command": command}, num_threads=1)
    assert command.interval == trained
    env.close()


def test_a_custom_command_is_trained_and_evaluated(library: GaitLibrary, tmp_path: Path) -> None:
    seen: set[float] = set()

    class Watched(SpeedCommand):
        def draw(self, shape: tuple[int, ...]) -> torch.Tensor:
            drawn = super().draw(shape)
            seen.update(drawn.flatten().tolist())
            return drawn

    # a repeated speed is drawn more often
    command = partial(Watched, library, speeds=[0.25, 0.5, 0.5, 1.0])
    make_env = partial(aslip.make_env, replace={"command": command})
    train = partial(make_training_env, make_env, 0.06)
    config = replace(TINY, out=tmp_path, total_steps=64)
    results = ppo_aslip.main(config, make_env, make_train_env=train)
    assert [r.speed for r in results] == [0.25, 0.5, 1.0]
    assert seen == {0.25, 0.5, 1.0}


def test_custom_observations_train_with_symmetry_and_walk(
    tmp_path: Path,
) -> None:
    """The policy file names its observation, and the policy walks in environments that have it."""
    signs = {"mirror_signs": {"own": (-1.0,)}}

    def make_env(**settings: Any) -> Any:
        table = (*OBSERVATION_TABLE, ("reference", "motor_position"), "own")
        stack = aslip.envs.insert_before(
            aslip.default_stack(), "observation", own=partial(Named, "own")
        )
        stack["observation"] = partial(AssembleObservation, table)
        return aslip.make_env(stack=stack, **settings)

    ppo_aslip.main(replace(TINY, out=tmp_path, total_steps=64), make_env, network=signs)
    Walker(tmp_path, make_env(num_threads=1)).step()
    Walker(tmp_path, make_env(num_threads=1, drop=["noise"])).step()
    with pytest.raises(ConfigurationError, match="an unnamed stack"):
        Walker(tmp_path)
    with pytest.raises(ConfigurationError, match=r"has \['reference/motor_position', 'own'\]"):
        Walker(tmp_path, aslip.make_env(num_threads=1))


@pytest.mark.parametrize("name", ["command", "observation"])
def test_a_stack_that_lacks_required_transforms_is_refused(tmp_path: Path, name: str) -> None:
    def nothing() -> Transform:
        return Named(name)

    with pytest.raises(AslipError, match=r"lacks a SpeedCommand|observation|phase and command"):
        ppo_aslip.main(
            replace(TINY, out=tmp_path), partial(aslip.make_env, replace={name: nothing})
        )


class Named(SeededTransform):
    """Write an entry of ones at resets and steps."""

    def __init__(self, name: str) -> None:
        super().__init__([], [name])

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        return self._call(self._request(tensordict))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        ones = torch.ones(*next_tensordict.batch_size, 1)
        return next_tensordict.set(self.out_keys[0], ones)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return extend_spec(observation_spec, {self.out_keys[0]: 1})


def test_a_reward_that_is_not_finite_is_named(tmp_path: Path) -> None:
    def root(orientation: torch.Tensor) -> torch.Tensor:
        return (orientation[..., :1] - 2).sqrt()

    term = partial(RewardTerm, "foot_orient", root, [("truth", "pelvis_orientation")])
    make_env = partial(aslip.make_env, replace={"foot_orient": term})
    with pytest.raises(TrainingStoppedError, match="'foot_orient' is not finite"):
        ppo_aslip.main(replace(TINY, out=tmp_path), make_env)


def test_a_run_cannot_resume_with_another_environment(tmp_path: Path) -> None:
    config = replace(TINY, out=tmp_path, total_steps=64)

    def make_env(weights: Mapping[str, float], **settings: Any) -> Any:
        reward = partial(WeightedReward, weights)
        return aslip.make_env(replace={"reward": reward}, drop=["noise"], **settings)

    paper, other = partial(make_env, PAPER_WEIGHTS), dict.fromkeys(PAPER_WEIGHTS, 0.2)
    ppo_aslip.main(config, paper)
    made_of = read_card(tmp_path)["made_by"]["transforms"]
    assert "noise" not in made_of
    assert "'com_vel': '0.3'" in made_of["reward"]
    assert json.loads((tmp_path / "config.json").read_text())["transforms"] == made_of
    resumed = replace(config, resume=True, total_steps=128)
    with pytest.raises(ConfigurationError, match="other settings: reward was"):
        ppo_aslip.main(resumed, partial(make_env, other))
    slower = partial(make_training_env, paper, 20.0)
    with pytest.raises(ConfigurationError, match="other settings: training/command was"):
        ppo_aslip.main(resumed, paper, make_train_env=slower)
    ppo_aslip.main(resumed, paper)


# --------------------------------------------------------------------- learning


def test_an_update_gets_correct_advantages_and_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It gets advantages (GAE written out), log-probabilities of the actor, and the settings."""
    config = replace(
        TINY,
        out=tmp_path / "run",
        std=1.0,
        last_std=0.5,
        gamma=0.9,
        gae_lambda=0.5,
        clip=0.3,
        value_scale=3.0,
        fall_after=0.0,
        last_learning_rate=1e-5,
        max_grad_norm=1e-3,
    )
    seen: list[float] = []
    stds: list[float] = []
    ends = torch.zeros(2)
    update = ppo_aslip.update

    def spied(data: Any, loss: Any, optimizer: Any, config: Any) -> Any:
        assert data["scale"].unique().numel() == 1
        stds.append(float(data["scale"].flatten()[0]))
        with torch.no_grad():
            likely = loss.actor_network.get_dist(data.clone()).log_prob(data["action"])
            now, later = (
                loss.critic_network(td.select("observation"))["state_value"]
                for td in (data, data["next"])
            )
        torch.testing.assert_close(likely, data["action_log_prob"], atol=1e-4, rtol=1e-4)
        after = data["next"]
        delta = after["reward"] + 0.9 * later * ~after["terminated"] - now
        advantage, running = torch.zeros_like(delta), torch.zeros(delta.shape[0], 1)
        for t in reversed(range(delta.shape[1])):
            running = delta[:, t] + 0.9 * 0.5 * running * ~after["done"][:, t]
            advantage[:, t] = running
        torch.testing.assert_close(data["value_target"], advantage + now, atol=1e-4, rtol=1e-4)
        normal = (advantage - advantage.mean()) / advantage.std()
        torch.testing.assert_close(data["advantage"], normal, atol=1e-3, rtol=1e-3)
        ends.add_(
            torch.stack(
                [after["terminated"].sum(), (after["truncated"] & ~after["terminated"]).sum()]
            )
        )
        assert float(loss.clip_epsilon) == pytest.approx(0.3)
        assert any(getattr(m, "factor", None) == 3.0 for m in loss.critic_network.modules())
        seen.append(optimizer.param_groups[0]["lr"])
        step = optimizer.step

        def watched(*args: Any, **kwargs: Any) -> Any:
            for net in (loss.actor_network, loss.critic_network):
                norm = torch.stack([p.grad.norm() for p in net.parameters()]).norm()
                assert 0 < norm <= 1e-3 * (1 + 1e-4)
            return step(*args, **kwargs)

        with monkeypatch.context() as patch:
            patch.setattr(optimizer, "step", watched)
            return update(data, loss, optimizer, config)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    short = {"step_limit": partial(StepCounter, 3)}
    ppo_aslip.main(config, partial(aslip.make_env, replace=short, drop=["low_reward"]))
    assert seen == pytest.approx([3e-4, 3e-4 * (1e-5 / 3e-4) ** 0.5])
    assert stds == pytest.approx([1.0, 0.5**0.5])
    assert read_card(config.out)["shape"].std == pytest.approx(0.5)
    assert ends[1] > 0


def test_a_recurrent_policy_trains_resumes_and_walks(tmp_path: Path) -> None:
    """A stopped and resumed training gives the weights of an uninterrupted one."""
    config = replace(TINY, symmetric=False, samples=64, minibatch=24, total_steps=192)
    network = {"hidden": (16, 8)}
    folders = [tmp_path / name for name in ("whole", "stopped")]
    for folder, steps in zip(folders, ([192], [128, 192]), strict=True):
        for total in steps:
            ppo_aslip.main(
                replace(config, out=folder, total_steps=total, resume=total != steps[0],
                        schedule_steps=192),
                make_actor=make_recurrent_actor,
                network=network,
            )  # fmt: skip
    whole, stopped = (aslip.load_policy(folder).state_dict() for folder in folders)
    assert all(torch.equal(whole[key], stopped[key]) for key in whole)
    assert any("gru" in key for key in whole)
    step = Walker(folders[0], speed=0.5).step()
    assert step["next", "memory"].abs().sum() > 0
    assert all(math.isfinite(float(row["kl_approx"])) for row in _rows(folders[0]))
