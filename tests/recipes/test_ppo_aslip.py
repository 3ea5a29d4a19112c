"""The PPO recipe trains from end to end, resumes, and accepts custom parts."""

import csv
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.transforms import StepCounter
from torchrl.record.loggers import CSVLogger

import aslip
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import make_recurrent_actor, policy_stack, read_card
from aslip.walking import Walker, WalkResult
from recipes import ppo_aslip, walk
from recipes.ppo_settings import scheduled, with_schedule
from tests.helpers import TINY


def _rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "progress.csv").open(newline="") as file:
        return list(csv.DictReader(file))


Run = tuple[Path, list[WalkResult]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run of two updates: folder and final evaluation."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    logger = CSVLogger("own", str(folder.with_name("logs")))
    results = ppo_aslip.main(replace(TINY, out=folder, total_steps=70), logger=logger)
    return folder, results


def test_a_run_writes_all_its_files(run: Run) -> None:
    folder, results = run
    for name in ("config.json", "progress.csv", "policy.zip", "summary.md", "learning_curve.png"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").iterdir())
    assert len(list((folder / "checkpoints").glob("*.zip"))) == 2
    assert not list(folder.rglob("*.part"))
    assert (folder.with_name("logs") / "own/scalars/episode_return.csv").exists()
    assert [round(r.speed, 3) for r in results] == [round(0.1 * i, 3) for i in range(21)]
    assert [row["step"] for row in _rows(folder)] == ["64", "128"]
    assert policy_stack(folder) == "straight"
    for result in results:
        assert 1 <= result.steps <= TINY.eval_steps
        assert 0 < result.total <= result.steps
        assert all(0 <= value <= 1 for value in result.terms.values())


def test_runs_with_the_same_seed_are_equal_with_or_without_evaluations(
    run: Run, tmp_path: Path
) -> None:
    """They are equal to the last digit, except for times and additional evaluations."""
    config = replace(TINY, out=tmp_path / "again", total_steps=70, eval_interval=64)
    assert ppo_aslip.main(config) == run[1]
    first, second = _rows(run[0]), _rows(config.out)
    for row in (*first, *second):
        for name in [name for name in row if name.startswith(("elapsed_s", "steps_per", "eval_"))]:
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
    for key in (key for key in weights if key.endswith("count")):
        assert torch.equal(resumed[key], weights[key] + 64)
    ppo_aslip.main(longer)
    assert "nothing left to train after 192 of 192" in capsys.readouterr().out


def test_an_interrupted_evaluation_keeps_the_update_and_its_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*args: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ppo_aslip, "evaluate_all", interrupted)
    folder = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        ppo_aslip.main(replace(TINY, out=folder, eval_interval=64, checkpoint_minutes=100))
    assert [row["step"] for row in _rows(folder)] == ["64"]
    assert [path.stem for path in folder.glob("checkpoints/*.zip")] == ["checkpoint-000000000064"]
    assert walk.training_length(str(folder)) == "trained for 64 policy steps of 128"
    with pytest.raises(FileDamagedError, match=r"is a checkpoint, not a policy; .*policy\.zip"):
        aslip.load_policy(next(folder.glob("checkpoints/*.zip")))


def test_numbers_of_a_batch() -> None:
    """A critic that is right to a constant explains all of the variance."""
    target = torch.tensor([[1.0], [2.0], [6.0]])
    values = {"value_target": target, "action_log_prob": torch.tensor([3.0, 4.0, 5.0])}
    for value, explained in ((target - 3, 1.0), (torch.zeros(3, 1), 0.0), (target / 2, 0.75)):
        data = TensorDict({**values, "state_value": value}, batch_size=3)
        found = ppo_aslip.batch_numbers(data)
        assert found == {"entropy": -4.0, "explained_variance": pytest.approx(explained)}


def test_schedules_decay_exponentially_at_the_end() -> None:
    config = replace(TINY, total_steps=256, fall_after=0.5)
    values = [scheduled(config, step, 0.4, 0.1) for step in (0, 128, 192, 256, 512)]
    assert values == pytest.approx([0.4, 0.4, 0.2, 0.1, 0.1])
    kept = {"total_steps": 1000, "schedule_steps": 2000}
    assert with_schedule(replace(TINY, total_steps=3000), kept).schedule_steps == 2000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs must be positive, got 0"),
        ({"samples": 100}, "samples must be a multiple of num_envs = 8, got 100"),
        ({"gamma": 1.5}, "gamma"),
        ({"checkpoint_minutes": -1.0}, "checkpoint_minutes must be 0 or more"),
        ({"seed": -1}, "seed must be from 0 to .*, got -1"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(TINY, **change)


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
    short = {"step_limit": StepCounter(3)}
    ppo_aslip.main(config, partial(aslip.make_env, replace=short, drop=["low_reward"]))
    assert seen == pytest.approx([3e-4, 3e-4 * (1e-5 / 3e-4) ** 0.5])
    assert stds == pytest.approx([1.0, 0.5**0.5])
    assert read_card(config.out)["shape"].std == pytest.approx(0.5)
    assert ends[1] > 0


def test_a_recurrent_policy_trains_resumes_and_walks(tmp_path: Path) -> None:
    """A stopped and resumed training gives the weights of an uninterrupted one."""
    config = replace(TINY, symmetric=False, samples=64, minibatch=24, total_steps=128)
    network = {"hidden": (16, 8)}
    folders = [tmp_path / name for name in ("whole", "stopped")]
    for folder, steps in zip(folders, ([128], [64, 128]), strict=True):
        for total in steps:
            ppo_aslip.main(
                replace(config, out=folder, total_steps=total, resume=total != steps[0],
                        schedule_steps=128),
                make_actor=make_recurrent_actor,
                network=network,
            )  # fmt: skip
    whole, stopped = (aslip.load_policy(folder).state_dict() for folder in folders)
    assert all(torch.equal(whole[key], stopped[key]) for key in whole)
    assert any("gru" in key for key in whole)
    step = Walker(folders[0], speed=0.5, seed=0).step()
    assert step["next", "memory"].abs().sum() > 0
    assert all(math.isfinite(float(row["kl_approx"])) for row in _rows(folders[0]))
