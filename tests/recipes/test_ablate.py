"""Ablations: variants, their results, and resuming."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ablate
import pytest
import torch
from ablate import VARIANTS
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.transforms import Transform

import aslip
from aslip.errors import ConfigurationError, FileDamagedError, UnknownNameError
from aslip.transforms import ActionDelta, AssembleObservation
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import WalkResult


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small updates and short walks."""
    small = {"num_envs": 4, "samples": 16, "minibatch": 8, "eval_steps": 3}
    monkeypatch.setitem(
        ablate.PRESETS, "default", ablate.replace(ablate.PRESETS["default"], **small)
    )


def tiny(out: Path, *variants: str, seeds: tuple[int, ...] = (0,)) -> ablate.Config:
    return ablate.Config(variants, seeds, total_steps=16, num_envs=4, out=out)


def env_of(name: str) -> Any:
    return aslip.make_env(num_envs=2, **VARIANTS[name].edits())


@pytest.mark.parametrize("name", sorted(VARIANTS))
def test_every_variant_has_an_environment(name: str) -> None:
    env = env_of(name)
    env.rollout(2)
    env.close()


@pytest.mark.parametrize("term", sorted(PAPER_WEIGHTS))
def test_an_ablated_term_is_still_reported(term: str) -> None:
    rollout = env_of(f"no_{term}").rollout(2)
    terms = rollout["next", "reward_terms"]
    assert set(terms.keys()) == set(PAPER_WEIGHTS)
    others = sum(w * terms[name] for name, w in PAPER_WEIGHTS.items() if name != term)
    expected = others / (1 - PAPER_WEIGHTS[term])
    torch.testing.assert_close(rollout["next", "reward"], expected)


class MotorTargets(Transform):
    """Record the motor targets that the base environment receives."""

    def __init__(self) -> None:
        super().__init__()
        self.received: list[torch.Tensor] = []

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.received.append(tensordict["motor_target"].clone())
        return tensordict


def test_the_no_delta_variant_adds_actions_to_the_standing_pose() -> None:
    env = env_of("no_delta")
    td = env.reset()
    assert torch.equal(td["baseline", "motor_position"][0], td["baseline", "motor_position"][1])
    targets = MotorTargets()
    env.insert_transform(0, targets)  # directly around the base environment
    env.step(td.set("action", torch.full((2, 10), 0.25)))
    (target,) = targets.received
    torch.testing.assert_close(target, td["baseline", "motor_position"] + 0.25)


def test_without_inputs_of_the_model_the_policy_sees_clock_and_speed() -> None:
    assert env_of("no_model_inputs").reset()["observation"].shape == (2, 49)


def test_finished_trainings_are_not_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = ablate.main(tiny(tmp_path, "default"))
    assert "1 of 1: default, seed 0" in capsys.readouterr().out
    # a single seed has no interval
    shown = (tmp_path / "ablation.md").read_text()
    assert "values of one seed" in shown
    assert "interval" not in shown
    assert "±" not in shown
    both = ablate.main(tiny(tmp_path, "default", "no_symmetry", seeds=(0, 1)))
    printed = capsys.readouterr().out
    assert "of 4: default, seed 0" not in printed
    assert "left" in printed
    shown = (tmp_path / "ablation.md").read_text()
    assert "mean and 95 % interval over seeds; the largest" in shown
    assert both["default"][0] == first["default"][0]
    rows = (tmp_path / "ablation.md").read_text().splitlines()
    assert [row.split("|")[1].strip() for row in rows[2:4]] == ["default", "no_symmetry"]
    assert "±" in rows[2]
    assert (tmp_path / "ablation.png").stat().st_size > 10_000


def test_an_interrupted_training_gives_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An ablation continues where it stopped if command and budget are the same."""
    config = ablate.replace(tiny(tmp_path, "default", "no_symmetry"), total_steps=32)
    update, calls = ablate.ppo_aslip.update, []

    def interrupted(*args: Any) -> dict[str, float]:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return update(*args)

    monkeypatch.setattr(ablate.ppo_aslip, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ablate.main(config, go_on="python ablate.py --seeds 0")
    said = capsys.readouterr().err
    assert "interrupted after 16 policy steps" in said
    assert "default-0" in said
    assert "to continue: python ablate.py --seeds 0\n" in said
    other = ablate.replace(config, total_steps=64)
    with pytest.raises(ConfigurationError, match=r"default-0.*total_steps.*--out"):
        ablate.main(other)
    assert not list(tmp_path.glob("*/judged.json"))
    assert not (tmp_path / "no_symmetry-0").exists()
    found = ablate.main(config)
    assert len(calls) == 2 + 1 + 2
    assert list(found) == ["default", "no_symmetry"]


def test_damaged_results_are_named(tmp_path: Path) -> None:
    ablate.main(tiny(tmp_path, "default"))
    file = tmp_path / "default-0" / "judged.json"
    for text in (file.read_text()[:-20], "[]", "{}"):
        file.write_text(text)
        with pytest.raises(FileDamagedError, match="default-0"):
            ablate.main(tiny(tmp_path, "default"))


def test_results_of_another_budget_are_refused(tmp_path: Path) -> None:
    """A finished training, whose learning rate has decayed, is not one with a larger budget."""
    ablate.main(tiny(tmp_path, "default"))
    for change in ({"total_steps": 32}, {"num_envs": 8}):
        with pytest.raises(ConfigurationError, match=rf"default-0.*{next(iter(change))}.*--out"):
            ablate.main(ablate.replace(tiny(tmp_path, "default"), **change))


def test_the_first_message_estimates_the_remaining_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny(tmp_path, "default", "no_delta", seeds=(0, 1))
    monkeypatch.setattr(ablate, "estimated_seconds", lambda _: 3000.0)
    assert "4 of 4 trainings to go, 16 policy steps each: about 3:20:00 " in ablate.announcement(
        config, 4
    )
    (tmp_path / "no_delta-1").mkdir()
    (tmp_path / "no_delta-1" / "judged.json").write_text("{}")
    assert "3 of 4 trainings to go, 16 policy steps each: about 2:30:00 " in ablate.announcement(
        config, 4
    )


def test_the_estimate_grows_with_the_length_of_the_training(tmp_path: Path) -> None:
    """The estimate is proportional to the steps, plus the evaluation."""
    config = tiny(tmp_path, "default")
    assert 0 < ablate.estimated_seconds(config) < 1e3
    longer = ablate.estimated_seconds(ablate.replace(config, total_steps=10**9))
    assert longer > 100 * ablate.estimated_seconds(config)


def test_the_names_on_the_command_line_are_those_of_the_variants() -> None:
    assert tuple(VARIANTS) == ablate.NAMES


def test_the_return_is_that_of_the_papers_reward_until_the_fall() -> None:
    """It does not depend on the rewards of the training; early falls give low returns."""
    terms = [dict.fromkeys(PAPER_WEIGHTS, value) for value in (0.5, 1.0)]
    fell = WalkResult(1.0, 100, False, -7.0, 0.7, 0.0, 1.0, terms[0])
    walked = WalkResult(0.5, 400, True, -7.0, 0.6, 0.0, 1.0, terms[1])
    found = ablate.measures([fell, walked])
    assert found["paper's return"] == pytest.approx((100 * 0.5 + 400 * 1.0) / 2)
    assert found["speed error m/s"] == pytest.approx((0.3 + 0.1) / 2)
    assert [found[name] for name in ("survived", "on the feet", "tracked")] == [1, 2, 1]
    assert [found[name] for name in PAPER_WEIGHTS] == [pytest.approx(0.75)] * len(PAPER_WEIGHTS)


def test_a_table_of_one_and_several_seeds_explains_its_intervals() -> None:
    assert "several" in ablate._cells({"default": {0: [], 1: []}, "truth": {0: []}})


def test_unknown_variants_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="no_reward"):
        ablate.Config(variants=("no_reward",))


def test_the_list_states_the_question_of_each_variant(capsys: pytest.CaptureFixture[str]) -> None:
    assert ablate.main(ablate.Config(list=True)) == {}
    printed = capsys.readouterr().out
    assert all(name in printed and v.question in printed for name, v in VARIANTS.items())


# ---------------------------------------------------------------- evaluation


def evaluation_env_of(name: str) -> Any:
    stack = aslip.envs.evaluation_stack(ablate.trained_on(VARIANTS[name]))
    return aslip.make_env(num_envs=2, num_threads=1, stack=stack)


@pytest.mark.parametrize("name", sorted(VARIANTS))
def test_each_policy_is_evaluated_with_its_own_observation(name: str) -> None:
    """It gets its own observation and baseline, at the same state of the robot."""
    trained, evaluating = env_of(name), evaluation_env_of(name)
    start = TensorDict(command=torch.ones(2, 1), phase=torch.full((2, 1), 0.3), batch_size=2)
    own, seen = trained.reset(start.clone()), evaluating.reset(start.clone())
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


@pytest.mark.parametrize("name", sorted(VARIANTS))
def test_all_policies_are_evaluated_with_the_same_rewards(name: str) -> None:
    """Equal robots in equal states with equal motor targets get equal rewards."""
    found, target = [], torch.zeros(2, 10)
    for variant in ("default", name):
        env = evaluation_env_of(variant)
        start = TensorDict(command=torch.ones(2, 1), phase=torch.full((2, 1), 0.3), batch_size=2)
        td = env.reset(start)
        (delta,) = [t for t in env.transforms if isinstance(t, ActionDelta)]
        target = target if found else td[delta.baseline_key].clone()
        td["action"] = target - td[delta.baseline_key]
        found.append(env.step(td)["next"])
    names = set(PAPER_WEIGHTS) - {
        "action_diff"
    }  # the term of actions, which are added to different baselines
    for key in [("truth", "qpos"), *(("reward_terms", term) for term in sorted(names))]:
        torch.testing.assert_close(found[1][key], found[0][key], rtol=0, atol=1e-5)
    total = sum(w * found[1]["reward_terms", term] for term, w in PAPER_WEIGHTS.items())
    torch.testing.assert_close(found[1]["reward"], total)
    assert {key: float(v[0]) for key, v in env.base_env.dynamics.items()} == dict(
        env.base_env._dynamics.nominal
    )


def test_results_come_from_the_evaluation_stack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved results come from walks of the saved policy on the evaluation stack."""
    envs, found = [], []
    measure = ablate.evaluate

    def spied(policy: Any, env: Any, *args: Any) -> Any:
        envs.append(env)
        found.append(measure(policy, env, *args))
        return found[-1]

    for module in (ablate, ablate.ppo_aslip):
        monkeypatch.setattr(module, "evaluate", spied)
    kept = ablate.main(tiny(tmp_path, "reward_on_estimate"))["reward_on_estimate"][0]
    assert kept == found[-1]
    assert ["judge" in env.transform_names for env in envs] == [False, True]
