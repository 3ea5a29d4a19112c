"""The recipes run from end to end, resume, and repeat themselves."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Composite
from torchrl.envs.transforms import StepCounter, Transform

import aslip
from aslip.errors import AslipError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import policy_stack, read_card
from aslip.robot import CASSIE
from aslip.robot.model import physics_timesteps
from aslip.training.collect import local
from aslip.training.ppo_settings import with_schedule
from aslip.training.run import TrainingStoppedError
from aslip.transforms import (
    OBSERVATION_TABLE,
    AssembleObservation,
    ObservationNoise,
    RandomNoise,
    RewardTerm,
    SeededTransform,
    SpeedCommand,
    WeightedReward,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import Walker, WalkResult, evaluate
from recipes import ablate, ppo_aslip
from tests.helpers import TINY


def _rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "progress.csv").open(newline="") as file:
        return list(csv.DictReader(file))


EVAL_STEPS = 5


@pytest.fixture(scope="module", autouse=True)
def short_walks() -> Iterator[None]:
    """Evaluate for a few steps only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo_aslip, "evaluate", partial(evaluate, num_steps=EVAL_STEPS))
        yield


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[WalkResult]]:
    """A run of two updates; all speeds evaluated at its end."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    return folder, ppo_aslip.main(replace(TINY, out=folder))


def test_a_run_leaves_all_its_files(run: tuple[Path, list[WalkResult]]) -> None:
    folder, results = run
    for name in ("config.json", "progress.csv", "policy.zip", "summary.md", "learning_curve.png"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").iterdir())
    assert len(list((folder / "checkpoints").iterdir())) == 2
    assert not list(folder.rglob("*.part"))
    assert [round(r.speed, 3) for r in results] == [round(0.1 * i, 3) for i in range(21)]


def test_progress_has_a_row_an_update(run: tuple[Path, list[WalkResult]]) -> None:
    rows = _rows(run[0])
    assert [row["step"] for row in rows] == ["64", "128"]
    for row in rows:
        for name, value in row.items():
            assert value, name
        for term in ("com_vel", "foot_pos", "straight_diff", "foot_orient", "action_diff"):
            assert 0 <= float(row[f"term_{term}"]) <= 1
    assert float(rows[-1]["eval_return"]) > 0


def test_results_are_plausible(run: tuple[Path, list[WalkResult]]) -> None:
    for result in run[1]:
        assert 1 <= result.steps <= EVAL_STEPS
        assert 0 < result.total <= result.steps
        assert result.weight_ratio > 0
        assert all(0 <= value <= 1 for value in result.terms.values())


def test_the_summary_has_a_row_a_speed(run: tuple[Path, list[WalkResult]]) -> None:
    lines = (run[0] / "summary.md").read_text().splitlines()
    assert sum(line.startswith("| ") for line in lines) == 23
    assert "of 21 speeds" in "\n".join(lines)
    assert "128 policy steps" in lines[-1]


def test_the_runs_policy_can_be_loaded(run: tuple[Path, list[WalkResult]]) -> None:
    policy = aslip.load_policy(run[0])
    assert policy(aslip.make_env(num_threads=1).reset())["action"].shape == (1, 10)


def test_the_same_seed_gives_the_same_run(
    run: tuple[Path, list[WalkResult]], tmp_path: Path
) -> None:
    """Every number but the time it took."""
    again = ppo_aslip.main(replace(TINY, out=tmp_path / "again"))
    first, second = _rows(run[0]), _rows(tmp_path / "again")
    for row in (*first, *second):
        del row["elapsed_s"]
    assert first == second
    assert again == run[1]
    a, b = (aslip.load_policy(folder).state_dict() for folder in (run[0], tmp_path / "again"))
    assert all(torch.equal(a[key], b[key]) for key in a)


def test_a_run_resumes(run: tuple[Path, list[WalkResult]], tmp_path: Path) -> None:
    """What was trained is kept, the steps count on, and the policy changes."""
    folder, _ = run
    before, weights = _rows(folder), aslip.load_policy(folder).state_dict()
    ppo_aslip.main(replace(TINY, out=folder, resume=True, total_steps=192))
    after = _rows(folder)
    assert [row["step"] for row in after] == ["64", "128", "192"]
    assert after[:2] == before
    assert float(after[2]["elapsed_s"]) > float(before[1]["elapsed_s"])
    resumed = aslip.load_policy(folder).state_dict()
    changed = [key for key in weights if not torch.equal(weights[key], resumed[key])]
    assert any("weight" in key for key in changed)
    counts = [key for key in weights if key.endswith("count")]
    assert counts
    assert all(resumed[key] == weights[key] + 64 for key in counts)


def test_a_finished_run_goes_on_with_its_last_learning_rate_and_exploration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A longer training does not stretch the schedule; to say so does."""
    seen: list[tuple[float, float]] = []
    update = ppo_aslip.update

    def spied(data: Any, loss: Any, optimizer: Any, *args: Any) -> Any:
        seen.append((optimizer.param_groups[0]["lr"], float(data["scale"][0, 0, 0])))
        return update(data, loss, optimizer, *args)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    schedule: dict[str, Any] = {
        "learning_rate": 1e-3,
        "last_learning_rate": 1e-5,
        "fall_after": 0.0,
    }
    config = replace(TINY, out=tmp_path, std=0.4, last_std=0.1, **schedule)
    ppo_aslip.main(config)
    assert seen == [pytest.approx((1e-3, 0.4)), pytest.approx((1e-4, 0.2))]
    for total in (256, 320):  # the second knows of the first only by the folder
        ppo_aslip.main(replace(config, resume=True, total_steps=total))
    assert seen[2:] == [pytest.approx((1e-5, 0.1))] * 3
    ppo_aslip.main(replace(config, resume=True, total_steps=384, schedule_steps=640))
    assert seen[5] == pytest.approx((1e-3 * 0.01**0.5, 0.1))


def test_a_run_of_before_schedules_had_steps_keeps_its_schedule() -> None:
    kept = {"total_steps": 1000}
    assert with_schedule(replace(TINY, total_steps=3000), kept).schedule_steps == 1000
    kept |= {"schedule_steps": 2000}
    assert with_schedule(replace(TINY, total_steps=3000), kept).schedule_steps == 2000


def test_the_bar_moves_at_each_policy_step_and_changes_no_action() -> None:
    actor = torch.nn.Linear(2, 2)
    plain = [actor(torch.ones(2)) for _ in range(6)]
    moves: list[int] = []

    class Bar:
        """A bar that says whether it was drawn, as tqdm does."""

        def update(self, steps: int) -> bool:
            moves.append(steps)
            return len(moves) % 2 == 0

        def set_description(self, *args: Any, **kwargs: Any) -> None:
            pass

    def batches() -> Iterator[Any]:
        for _ in range(2):
            yield torch.stack([actor(torch.ones(2)) for _ in range(3)])

    found, counts = [], []
    for batch in ppo_aslip.watched(batches(), cast("Any", actor), cast("Any", Bar()), robots=8):
        counts.append(len(moves))
        actor(torch.ones(2))  # an evaluation is no training
        found.append(batch)
    assert counts == [3, 6]
    assert moves == [8] * 6
    torch.testing.assert_close(torch.cat(found), torch.stack(plain), rtol=0, atol=0)


def test_the_start_says_where_what_and_how_to_stop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And how the number of steps is rounded; a resumed run says what changes."""
    out = tmp_path / "run"
    ppo_aslip.main(replace(TINY, out=out, total_steps=70), go_on="python here.py --resume")
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == (
        f"{out}: training for 128 policy steps (70 asked for, in updates of 64); preset default,"
        " seed 0, 8 robots"
    )
    assert second == "Ctrl-C saves and stops; to go on: python here.py --resume"
    assert [row["step"] for row in _rows(out)] == ["64", "128"]
    ppo_aslip.main(replace(TINY, out=out, total_steps=192, resume=True))
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith(f"{out}: going on after 128 of 192 policy steps; preset default")
    assert first.endswith("; total_steps 70 -> 192")
    ppo_aslip.main(replace(TINY, out=out, total_steps=192, resume=True))
    assert "nothing left to train after 192 of 192" in capsys.readouterr().out


def test_another_run_in_the_same_folder_is_refused(run: tuple[Path, list[WalkResult]]) -> None:
    with pytest.raises(ConfigurationError, match="holds a run already"):
        ppo_aslip.main(replace(TINY, out=run[0]))
    with pytest.raises(ConfigurationError, match="seed was 0 and is 1"):
        ppo_aslip.main(replace(TINY, out=run[0], resume=True, seed=1))


def test_another_seed_gives_another_run(run: tuple[Path, list[WalkResult]], tmp_path: Path) -> None:
    ppo_aslip.main(replace(TINY, out=tmp_path / "other", seed=1, total_steps=64))
    first, second = _rows(run[0])[0], _rows(tmp_path / "other")[0]
    assert first["term_com_vel"] != second["term_com_vel"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs must be 1 or more, got 0"),
        ({"total_steps": -5}, "total_steps"),
        ({"minibatch": 0}, "minibatch"),
        ({"epochs": 0}, "epochs"),
        ({"samples": 100}, "samples must be a multiple of num_envs = 8, got 100"),
        ({"learning_rate": -1e-4}, "learning_rate"),
        ({"fall_after": 1.0}, "fall_after"),
        ({"gamma": 1.5}, "gamma"),
        ({"eval_interval": 0}, "eval_interval"),
        ({"command_interval": 0.001}, "command_interval must be 0, or a policy step"),
        ({"checkpoint_minutes": -1.0}, "checkpoint_minutes must be 0 or more"),
        ({"seed": -1}, r"seed must be from 0 to 2\*\*63 - 1, got -1"),
        ({"seed": 2**63}, "seed"),
        ({"num_envs": 8.0}, r"num_envs must be a whole number, got 8\.0"),
        ({"num_envs": True}, "num_envs must be a whole number, got True"),
        ({"learning_rate": float("nan")}, "learning_rate must be a finite number, got nan"),
        ({"gamma": "0.9"}, "gamma must be a finite number, got '0.9'"),
        ({"symmetric": 1}, "symmetric must be True or False, got 1"),
        ({"stack": "aslpi"}, r"stack must be \('aslip', 'paper', .* got 'aslpi'"),
        ({"out": "runs"}, "out must be a Path, got 'runs'"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(TINY, **change)


@pytest.mark.parametrize(
    ("settings", "noise"),
    [
        ({"coarse": True}, [RandomNoise]),
        ({"truth": True}, []),
        ({"stack": "single_reference"}, [RandomNoise]),
    ],
)
def test_robots_differ_in_training_and_not_in_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: dict[str, Any], noise: list[type]
) -> None:
    envs: list[Any] = []

    def collector(env: Any, *args: Any, **kwargs: Any) -> Any:
        envs.append(env)
        return Collector(env, *args, **kwargs)

    def evaluated(actor: Any, env: Any, speeds: list[float]) -> list[WalkResult]:
        envs.append(env)
        return evaluate(actor, env, speeds, num_steps=EVAL_STEPS)

    monkeypatch.setattr(local, "Collector", collector)
    monkeypatch.setattr(ppo_aslip, "evaluate", evaluated)
    ppo_aslip.main(replace(TINY, out=tmp_path / "run", randomise=True, **settings))
    trained, judged = envs
    intervals = [next(t for t in e.transforms if isinstance(t, SpeedCommand)) for e in envs]
    assert [command.interval for command in intervals] == [TINY.command_interval, math.inf]
    masses = trained.base_env.dynamics["mass"]
    assert masses.min() < masses.max()
    assert (judged.base_env.dynamics["mass"] == 1.0).all()
    found = [[type(t) for t in env.transforms if isinstance(t, ObservationNoise)] for env in envs]
    assert found == [noise, [ObservationNoise] * len(noise)]
    steps = [env.base_env.model.opt.timestep for env in envs]
    assert steps == [physics_timesteps()[settings.get("coarse", False)], CASSIE.physics_timestep]


@pytest.mark.parametrize(("own", "trained"), [(20.0, 20.0), (0.3, 0.3), (math.inf, 8.0)])
def test_an_interval_of_a_command_that_was_given_is_kept(
    library: GaitLibrary, own: float, trained: float
) -> None:
    command = SpeedCommand(library, interval=own)
    env = ppo_aslip.training_env(8.0, replace={"command": command}, num_threads=1)
    assert command.interval == trained
    env.close()


def test_a_transform_given_as_it_is_serves_training_and_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The README's way to weigh terms, in a training."""
    batches: list[Any] = []
    update = ppo_aslip.update

    def spied(data: Any, *args: Any) -> Any:
        batches.append(data["next"])
        return update(data, *args)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    weights = {name: float(name == "com_vel") for name in PAPER_WEIGHTS}
    edits = {"replace": {"reward": WeightedReward(weights)}}
    results = ppo_aslip.main(replace(TINY, out=tmp_path / "run"), edits)
    for result in results:
        assert result.total == pytest.approx(result.steps * result.terms["com_vel"], rel=1e-4)
    assert len(batches) == 2
    for batch in batches:
        torch.testing.assert_close(batch["reward"], batch["reward_terms", "com_vel"])


@pytest.mark.parametrize(
    ("fall_after", "expected"),
    [(0.0, [0.4, 0.4 / 2**0.5, 0.2, 0.2 / 2**0.5]), (0.5, [0.4, 0.4, 0.4, 0.2])],
)
def test_exploration_shrinks(
    fall_after: float, expected: list[float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples of one update have one deviation, and the policy's file has the last."""
    seen: list[float] = []
    update = ppo_aslip.update

    def spied(data: Any, *args: Any) -> Any:
        assert data["scale"].unique().numel() == 1
        seen.append(float(data["scale"][0, 0, 0]))
        return update(data, *args)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    config = replace(
        TINY, out=tmp_path / "run", total_steps=256, std=0.4, last_std=0.1, fall_after=fall_after
    )
    ppo_aslip.main(config)
    assert seen == pytest.approx(expected)
    std = read_card(config.out)["shape"].std
    assert std == pytest.approx(0.1)
    td = aslip.load_policy(config.out)(aslip.make_env().reset())
    assert td["scale"].unique().tolist() == pytest.approx([0.1])


def test_an_evaluation_leaves_the_random_numbers_of_training_alone(tmp_path: Path) -> None:
    runs = []
    for interval in (64, 10**6):
        config = replace(TINY, out=tmp_path / str(interval), eval_interval=interval)
        ppo_aslip.main(config)
        runs.append([row["loss_critic"] for row in _rows(config.out)])
    assert runs[0] == runs[1]


def test_own_commands_are_trained_and_evaluated(
    library: GaitLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: set[float] = set()

    class Watched(SpeedCommand):
        def draw(self, shape: tuple[int, ...]) -> torch.Tensor:
            drawn = super().draw(shape)
            seen.update(drawn.flatten().tolist())
            return drawn

    config = replace(TINY, out=tmp_path, total_steps=64, command_interval=0.06)
    # a speed may come twice, to be drawn more often
    command = Watched(library, speeds=[0.25, 0.5, 0.5, 1.0])
    results = ppo_aslip.main(config, {"replace": {"command": command}})
    assert [r.speed for r in results] == [0.25, 0.5, 1.0]
    assert seen == {0.25, 0.5, 1.0}


def test_a_policy_of_an_edited_stack_is_not_taken_for_one_of_the_default(tmp_path: Path) -> None:
    config = replace(TINY, total_steps=64)
    terms = {"replace": {"reward": WeightedReward(PAPER_WEIGHTS)}}
    ppo_aslip.main(replace(config, out=tmp_path / "terms"), terms)
    assert policy_stack(tmp_path / "terms") == "aslip"
    absolute = ablate.VARIANTS["no_delta"].edits()
    ppo_aslip.main(replace(config, out=tmp_path / "absolute"), absolute)
    with pytest.raises(ConfigurationError, match="a stack of its own"):
        Walker(tmp_path / "absolute")
    env = aslip.make_env(**absolute, num_threads=1)
    Walker(tmp_path / "absolute", env).step()


def test_a_policy_of_another_observation_goes_where_there_is_one(tmp_path: Path) -> None:
    table = (*OBSERVATION_TABLE, ("reference", "motor_position"), "command")
    edits: dict[str, Any] = {"replace": {"observation": partial(AssembleObservation, table)}}
    ppo_aslip.main(replace(TINY, out=tmp_path, total_steps=64), edits)
    Walker(tmp_path, aslip.make_env(**edits, num_threads=1)).step()
    edits["drop"] = ["noise"]
    Walker(tmp_path, aslip.make_env(**edits, num_threads=1)).step()
    clock = ablate.VARIANTS["no_model_inputs"].edits()
    with pytest.raises(
        ConfigurationError, match=r"lacks \['clock/sin', 'clock/cos'\] and .*has \['ref"
    ):
        Walker(tmp_path, aslip.make_env(**clock, num_threads=1))


@pytest.mark.parametrize("name", ["command", "observation"])
def test_a_stack_without_what_the_recipe_needs_is_refused(tmp_path: Path, name: str) -> None:
    def nothing() -> Transform:
        return Named(name)

    with pytest.raises(AslipError, match=r"lacks a SpeedCommand|observation|phase and command"):
        ppo_aslip.main(replace(TINY, out=tmp_path), {"replace": {name: nothing}})


class Named(SeededTransform):
    """Writes a key of ones, at resets and at steps."""

    def __init__(self, name: str) -> None:
        super().__init__([], [name])

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        return self._call(self._request(tensordict))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        ones = torch.ones(*next_tensordict.batch_size, 1)
        return next_tensordict.set(self.out_keys[0], ones)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return extend_spec(observation_spec, {self.out_keys[0]: 1})


def test_a_reward_that_is_no_number_is_named(tmp_path: Path) -> None:
    def root(orientation: torch.Tensor) -> torch.Tensor:
        return (orientation[..., :1] - 2).sqrt()

    term = partial(RewardTerm, "foot_orient", root, [("truth", "pelvis_orientation")])
    with pytest.raises(TrainingStoppedError, match="'foot_orient' is not finite"):
        ppo_aslip.main(replace(TINY, out=tmp_path), {"replace": {"foot_orient": term}})


def test_an_update_gets_what_ppo_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """GAE written out, samples as likely as the actor says, and the settings' numbers."""
    monkeypatch.setattr(ppo_aslip, "evaluate", partial(evaluate, num_steps=EVAL_STEPS))
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
    ends = torch.zeros(2)
    update = ppo_aslip.update

    def spied(data: Any, loss: Any, optimizer: Any, nets: Any, config: Any) -> Any:
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
            for parameters in nets:
                norm = torch.stack([p.grad.norm() for p in parameters]).norm()
                assert 0 < norm <= 1e-3 * (1 + 1e-4)
            return step(*args, **kwargs)

        with monkeypatch.context() as patch:
            patch.setattr(optimizer, "step", watched)
            return update(data, loss, optimizer, nets, config)

    monkeypatch.setattr(ppo_aslip, "update", spied)
    ppo_aslip.main(
        config, {"replace": {"step_limit": lambda: StepCounter(3)}, "drop": ["low_reward"]}
    )
    assert seen == pytest.approx([3e-4, 3e-4 * (1e-5 / 3e-4) ** 0.5])
    assert ends[1] > 0


def test_randomised_training_keeps_what_is_rewarded() -> None:
    config = replace(TINY, randomise=True, reward_on="estimate")
    stack = ppo_aslip.variety(config, {"stack": "aslip"})["stack"]
    assert ("odometry", "pelvis_velocity") in stack["com_vel"]().in_keys


def test_edits_are_kept_with_a_run_and_may_not_change(tmp_path: Path) -> None:
    config = replace(TINY, out=tmp_path, total_steps=64)
    edits = {"replace": {"reward": WeightedReward(PAPER_WEIGHTS)}, "drop": ["noise"]}
    ppo_aslip.main(config, edits)
    made_of = read_card(tmp_path)["made_by"]["transforms"]
    assert "noise" not in made_of
    assert "'com_vel': '0.3'" in made_of["reward"]
    other = {name: 0.2 for name in PAPER_WEIGHTS}
    for name, changed in (
        ("reward", {**edits, "replace": {"reward": WeightedReward(other)}}),
        ("noise", {**edits, "drop": []}),
    ):
        with pytest.raises(ConfigurationError, match=rf"other settings: {name} was"):
            ppo_aslip.main(replace(config, resume=True), changed)
    edits["replace"] = {"reward": WeightedReward(PAPER_WEIGHTS)}
    ppo_aslip.main(replace(config, resume=True, total_steps=128), edits)


def test_the_truth_goes_with_edits_in_every_form(tmp_path: Path) -> None:
    config = replace(TINY, out=tmp_path, total_steps=64, truth=True)
    (result, *_) = ppo_aslip.main(config, {"drop": "foot_orient", "replace": None})
    assert "foot_orient" not in result.terms
    kept = json.loads((tmp_path / "config.json").read_text())["transforms"]
    assert kept["estimator"].startswith("TrueState")
    assert "noise" not in kept
