"""Ablations: variants, their results, and resuming."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import ablate
import ablate_directions
import ablate_straight
import ablation
import ppo_aslip
import pytest
import torch
from ablate_settings import TASKS, Config
from ablate_straight import VARIANTS
from tensordict import TensorDict, TensorDictBase

import aslip
from aslip.envs import Stack, default_stack, evaluation_stack
from aslip.errors import (
    AslipError,
    AssetError,
    ConfigurationError,
    FileDamagedError,
    UnknownNameError,
)
from aslip.training.settings import read_settings
from aslip.transforms import ActionDelta, AssembleObservation
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import WalkResult


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """Small updates and short walks, without a picture of each training."""
    small = {"num_envs": 4, "samples": 16, "minibatch": 8, "eval_steps": 3}
    with pytest.MonkeyPatch.context() as patch:
        presets = ablate_straight.PRESETS
        patch.setitem(presets, "default", replace(presets["default"], **small))
        patch.setattr(ppo_aslip, "save_figure", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def trained_once(small: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Folder and results of an ablation of one seed of the default."""
    folder = tmp_path_factory.mktemp("ablation") / "runs"
    return folder, ablate.main(tiny(folder, "default"))


@pytest.fixture
def finished(trained_once: tuple[Path, Any], tmp_path: Path) -> Path:
    """Copy of the folder with one finished training."""
    return shutil.copytree(trained_once[0], tmp_path / "runs")


def tiny(out: Path, *variants: str, seeds: tuple[int, ...] = (0,)) -> Config:
    return Config(variants=variants, seeds=seeds, total_steps=16, num_envs=4, out=out)


def stack_of(name: str) -> Stack:
    return (VARIANTS[name].make_stack or default_stack)(aslip.GaitLibrary.load())


def env_of(name: str) -> Any:
    return aslip.make_env(num_envs=2, stack=stack_of(name))


def evaluation_env_of(name: str) -> Any:
    stack = evaluation_stack(stack_of(name))
    return aslip.make_env(num_envs=2, num_threads=1, stack=stack, seed=0)


@pytest.fixture(scope="module", params=sorted(VARIANTS))
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def training_env(name: str) -> Iterator[Any]:
    env = env_of(name)
    yield env
    env.close()


@pytest.fixture(scope="module")
def evaluating_env(name: str) -> Iterator[Any]:
    env = evaluation_env_of(name)
    yield env
    env.close()


@pytest.fixture(scope="module")
def default_step() -> tuple[torch.Tensor, TensorDictBase]:
    """Motor target and next entries of a step in the default variant's evaluation."""
    env = evaluation_env_of("default")
    target = env.reset(walking())[baseline_key(env)].clone()
    found = step_towards(env, target)
    env.close()
    return target, found


def test_every_variant_has_an_environment(training_env: Any) -> None:
    training_env.rollout(2)


def test_an_ablated_term_is_still_reported() -> None:
    term = "foot_pos"
    rollout = env_of(f"no_{term}").rollout(2)
    terms = rollout["next", "reward_terms"]
    assert set(terms.keys()) == set(PAPER_WEIGHTS)
    others = sum(w * terms[name] for name, w in PAPER_WEIGHTS.items() if name != term)
    expected = others / (1 - PAPER_WEIGHTS[term])
    torch.testing.assert_close(rollout["next", "reward"], expected)


def test_the_no_delta_variant_adds_actions_to_the_standing_pose() -> None:
    env = env_of("no_delta")
    td = env.reset()
    assert torch.equal(td["baseline", "motor_position"][0], td["baseline", "motor_position"][1])
    target = env.transform.inv(td.set("action", torch.full((2, 10), 0.25)))["motor_target"]
    torch.testing.assert_close(target, td["baseline", "motor_position"] + 0.25)


def test_without_inputs_of_the_model_the_policy_sees_clock_and_speed() -> None:
    assert env_of("no_model_inputs").reset()["observation"].shape == (2, 49)


def test_finished_trainings_are_not_repeated(
    trained_once: tuple[Path, Any], finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = trained_once[1]
    # a single seed has no interval
    shown = (finished / "ablation.md").read_text()
    assert "values of one seed" in shown
    assert "interval" not in shown
    assert "±" not in shown
    both = ablate.main(tiny(finished, "default", "no_symmetry", seeds=(0, 1)))
    printed = capsys.readouterr().out
    assert "2 of 4: no_symmetry, seed 0" in printed
    assert "of 4: default, seed 0" not in printed
    assert "left" in printed
    shown = (finished / "ablation.md").read_text()
    assert "mean and 95 % interval over seeds; the largest" in shown
    assert both["default"][0] == first["default"][0]
    rows = (finished / "ablation.md").read_text().splitlines()
    assert [row.split("|")[1].strip() for row in rows[2:4]] == ["default", "no_symmetry"]
    assert "±" in rows[2]
    assert (finished / "ablation.png").stat().st_size > 10_000


def test_an_interrupted_training_gives_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An ablation continues where it stopped if command and budget are the same."""
    config = replace(tiny(tmp_path, "default", "no_symmetry"), total_steps=32)
    update, calls = ppo_aslip.update, []

    def interrupted(*args: Any) -> dict[str, float]:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return update(*args)

    monkeypatch.setattr(ppo_aslip, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ablate.main(config, resume_command="python ablate.py --seeds 0")
    said = capsys.readouterr().err
    assert "training stopped after 16 policy steps" in said
    assert "default-0" in said
    assert "to continue: python ablate.py --seeds 0\n" in said
    other = replace(config, total_steps=64)
    with pytest.raises(ConfigurationError, match=r"default-0.*total_steps.*--out"):
        ablate.main(other)
    # also before trainings of variants that come first
    with pytest.raises(ConfigurationError, match=r"default-0.*total_steps.*--out"):
        ablate.main(replace(other, variants=("no_symmetry", "default")))
    assert not list(tmp_path.glob("*/results.json"))
    assert not (tmp_path / "no_symmetry-0").exists()
    found = ablate.main(config)
    assert len(calls) == 2 + 1 + 2
    assert list(found) == ["default", "no_symmetry"]


def test_damaged_results_are_named(finished: Path) -> None:
    file = finished / "default-0" / "results.json"
    for text in (file.read_text()[:-20], "[]", "{}"):
        file.write_text(text)
        with pytest.raises(FileDamagedError, match="default-0"):
            ablate.main(tiny(finished, "default"))


def test_results_of_another_budget_are_refused(finished: Path) -> None:
    """A finished training, whose learning rate has decayed, is not one with a larger budget."""
    for change in ({"total_steps": 32}, {"num_envs": 8}):
        with pytest.raises(ConfigurationError, match=rf"default-0.*{next(iter(change))}.*--out"):
            ablate.main(replace(tiny(finished, "default"), **change))


def test_an_unknown_variant_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="no_delta"):
        ablate.main(tiny(tmp_path, "no_dleta"))


_OWN = '''
from aslip.envs import insert_before
from aslip.transforms import WeightedReward

def heavy(stack):
    """Foot placement only.

    More.
    """
    weights = {**stack["reward"].weights, "foot_pos": 3.0}
    return {**stack, "reward": WeightedReward(weights)}

def quiet(stack):
    del stack["noise"]

def _helper(stack):
    raise AssertionError
'''


def test_own_variants_of_a_file_are_judged_on_the_same_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "own.py"
    file.write_text(_OWN)
    config = tiny(tmp_path / "runs", "default", str(file))
    assert ablate.main(replace(config, list=True)) == {}
    assert f"\n{'heavy':24s}Foot placement only.\n" in capsys.readouterr().out
    rewards: list[Stack] = []
    judge = ablate_straight.evaluation_stack

    def judged(*args: Any) -> Stack:
        rewards.append(judge(*args))
        return rewards[-1]

    monkeypatch.setattr(ablate_straight, "evaluation_stack", judged)
    assert [*ablate.main(config)] == ["default", "heavy", "quiet"]
    assert [stack["reward"].weights for stack in rewards] == [dict(PAPER_WEIGHTS)] * 3
    assert ["noise" in stack for stack in rewards] == [True, True, False]
    trained = read_settings(tmp_path / "runs" / "heavy-0")[1]
    assert "'foot_pos': '3.0'" in trained["reward"]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("default = lambda stack: stack\n\ndef default(stack): ...\n", r"\['default'\], which are"),
        ("x = 1\n", "defines no public function"),
        ("def mistaken(stack): del stack['start']\n", "no transform 'start'"),
    ],
)
def test_files_without_variants_and_broken_stacks_are_refused_before_any_training(
    tmp_path: Path, code: str, message: str
) -> None:
    file = tmp_path / "own.py"
    file.write_text(code)
    with pytest.raises(AslipError, match=message):
        ablate.main(tiny(tmp_path / "runs", "default", str(file)))
    assert not list(tmp_path.glob("runs/*"))
    with pytest.raises(AssetError, match=r"no file .*none\.py"):
        ablate.main(tiny(tmp_path / "runs", "none.py"))


def test_the_return_is_that_of_the_papers_reward_until_the_fall() -> None:
    """It does not depend on the rewards of the training; early falls give low returns."""
    terms = [dict.fromkeys(PAPER_WEIGHTS, value) for value in (0.5, 1.0)]
    fell = WalkResult(1.0, 100, False, -7.0, 0.7, 0.0, 1.0, terms[0])
    walked = WalkResult(0.5, 400, True, -7.0, 0.6, 0.0, 1.0, terms[1])
    found = ablation.measures([fell, walked], PAPER_WEIGHTS)
    assert found["return"] == pytest.approx((100 * 0.5 + 400 * 1.0) / 2)
    assert found["speed error m/s"] == pytest.approx((0.3 + 0.1) / 2)
    assert [found[name] for name in ("survived", "on the feet", "tracked")] == [1, 2, 1]
    assert [found[name] for name in PAPER_WEIGHTS] == [pytest.approx(0.75)] * len(PAPER_WEIGHTS)


def test_the_list_states_the_question_of_each_variant(capsys: pytest.CaptureFixture[str]) -> None:
    for task, variants in (("straight", VARIANTS), ("directions", ablate_directions.VARIANTS)):
        assert ablate.main(replace(TASKS[task], list=True)) == {}
        printed = capsys.readouterr().out
        assert all(name in printed and v.question in printed for name, v in variants.items())


# ---------------------------------------------------------------- evaluation


def walking() -> TensorDict:
    """Start in the middle of a stride at 1 m/s."""
    return TensorDict(command=torch.ones(2, 1), phase=torch.full((2, 1), 0.3), batch_size=2)


def baseline_key(env: Any) -> Any:
    """Entry to which the actions of an environment are added."""
    (delta,) = [t for t in env.transforms if isinstance(t, ActionDelta)]
    return delta.baseline_key


def step_towards(env: Any, target: torch.Tensor) -> TensorDictBase:
    """Next entries after one step with a motor target."""
    td = env.reset(walking())
    td["action"] = target - td[baseline_key(env)]
    return env.step(td)["next"]


def test_each_policy_is_evaluated_with_its_own_observation(
    training_env: Any, evaluating_env: Any
) -> None:
    """It gets its own observation and baseline, at the same state of the robot."""
    trained, evaluating = training_env, evaluating_env
    own, seen = trained.reset(walking()), evaluating.reset(walking())
    for group in ("reference", "baseline"):
        for key, value in own.get(group, TensorDict()).items():
            torch.testing.assert_close(seen[group, key], value, rtol=0, atol=0)
    assert own["observation"].shape == seen["observation"].shape
    for kind, name in ((AssembleObservation, "in_keys"), (ActionDelta, "baseline_key")):
        has = [
            [getattr(t, name) for t in env.transforms if isinstance(t, kind)]
            for env in (trained, evaluating)
        ]
        assert has[0] == has[1]


def test_all_policies_are_evaluated_with_the_same_rewards(
    evaluating_env: Any, default_step: tuple[torch.Tensor, TensorDictBase]
) -> None:
    """Equal robots in equal states with equal motor targets get equal rewards."""
    target, expected = default_step
    env, found = evaluating_env, step_towards(evaluating_env, target)
    names = set(PAPER_WEIGHTS) - {
        "action_diff"
    }  # the term of actions, which are added to different baselines
    for key in [("truth", "qpos"), *(("reward_terms", term) for term in sorted(names))]:
        torch.testing.assert_close(found[key], expected[key], rtol=0, atol=1e-5)
    total = sum(w * found["reward_terms", term] for term, w in PAPER_WEIGHTS.items())
    torch.testing.assert_close(found["reward"], total)
    assert {key: float(v[0]) for key, v in env.base_env.dynamics.items()} == dict(
        env.base_env._dynamics.nominal
    )


def test_results_come_from_the_evaluation_stack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved results come from walks of the saved policy on the evaluation stack."""
    envs, found = [], []
    measure = ablate_straight.evaluate

    def spied(policy: Any, env: Any, *args: Any) -> Any:
        envs.append(env)
        found.append(measure(policy, env, *args))
        return found[-1]

    for module in (ablate_straight, ppo_aslip):
        monkeypatch.setattr(module, "evaluate", spied)
    kept = ablate.main(tiny(tmp_path, "reward_on_estimate"))["reward_on_estimate"][0]
    assert kept == found[-1]
    assert ["comparison" in env.transform_names for env in envs] == [False, True]
