"""Collectors in other processes: samples, weights, and the end of the processes."""

from __future__ import annotations

import importlib
import importlib.util
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.value import GAE

import aslip
from aslip.errors import ConfigurationError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, make_critic, set_std
from aslip.training.cluster import SENT, DistributedCollectors
from aslip.training.collectors import LocalCollector
from aslip.training.progress import read_progress
from aslip.training.ray import RayCollectors, threads_each
from aslip.training.run import TrainingStoppedError
from recipes import ppo_aslip
from recipes.ppo_cluster import ClusterConfig
from recipes.ppo_cluster import main as train_on_cluster
from tests.helpers import TINY, differing

ROBOTS, SAMPLES = 4, 32

_KINDS: dict[str, Any] = {
    "single": LocalCollector,
    "distributed": DistributedCollectors,
    "ray": RayCollectors,
}

without_ray = importlib.util.find_spec("ray") is None
needs_ray = pytest.mark.skipif(without_ray, reason="Ray is not installed")


@dataclass
class Learner:
    """Actor and normaliser, with a stand-in for training."""

    actor: ProbabilisticActor
    normalizer: RunningNormalizer

    @classmethod
    def make(cls) -> Learner:
        torch.manual_seed(0)
        normalizer = RunningNormalizer(64)
        shape = PolicyShape(symmetric=True, std=1.0)  # this actor soon falls
        return cls(make_actor(normalizer, shape), normalizer)

    @torch.no_grad()
    def learn(self, data: TensorDict) -> None:
        """Change every weight and statistic, and the standard deviation."""
        for parameter in self.actor.parameters():
            parameter += 0.01
        set_std(self.actor, 0.8)
        self.normalizer.update(3 * data.get("observation") + 1)

    def log_prob(self, data: TensorDict) -> torch.Tensor:
        """Log-probability of the batch's actions under the current actor."""
        with torch.no_grad():
            return self.actor.get_dist(data.clone()).log_prob(data["action"])


def _collector(kind: str, actor: torch.nn.Module, **settings: Any) -> Any:
    settings = {"num_envs": ROBOTS, "samples": SAMPLES, "seed": 3, **settings}
    return _KINDS[kind](aslip.make_env, actor, **settings)


def _batches(kind: str, number: int = 2) -> tuple[list[TensorDict], list[float]]:
    """Batches with learning in between, and errors of their log-probabilities."""
    learner, batches, errors = Learner.make(), [], []
    with _collector(kind, learner.actor) as collector:
        for data in collector:
            batches.append(data)
            errors.append(float((learner.log_prob(data) - data["action_log_prob"]).abs().max()))
            learner.learn(data)
            if len(batches) == number:
                break
    return batches, errors


@pytest.fixture(scope="module")
def distributed() -> tuple[list[TensorDict], list[float]]:
    return _batches("distributed")


@pytest.fixture(scope="module")
def ray() -> Iterator[tuple[list[TensorDict], list[float]]]:
    yield _batches("ray")
    assert not importlib.import_module("ray").is_initialized()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["distributed", pytest.param("ray", marks=needs_ray)])
class TestOtherProcesses:
    @pytest.fixture
    def collected(
        self, kind: str, request: pytest.FixtureRequest
    ) -> tuple[list[TensorDict], list[float]]:
        return request.getfixturevalue(kind)

    def test_weights_and_normaliser_arrive(self, collected: Any) -> None:
        """Log-probabilities are those of the actor at the time of the request."""
        batches, errors = collected
        assert errors == pytest.approx([0.0, 0.0], abs=1e-5)
        # those of the previous actor differ
        stale = Learner.make()
        assert (stale.log_prob(batches[1]) - batches[1]["action_log_prob"]).abs().max() > 0.1

    def test_batches_are_like_those_of_this_process(self, collected: Any) -> None:
        learner = Learner.make()
        with _collector("single", learner.actor) as collector:
            single = next(iter(collector))
        for data in collected[0]:
            assert data.shape == single.shape == (ROBOTS, SAMPLES // ROBOTS)
            assert data.names == single.names
            kept = [key for key in SENT if key in single.keys(True)]
            assert set(kept) == {key for key in SENT if key in data.keys(True)}
            assert set(SENT) - set(kept) == {"stagger"}  # entries for trainings only
            for key in kept:
                assert data[key].shape == single[key].shape
                if isinstance(data[key], torch.Tensor):
                    assert data[key].dtype == single[key].dtype

    def test_rows_are_robots_through_time(self, collected: Any) -> None:
        """`next` of a step equals the following step, also across batches."""
        first, second = collected[0]
        data: Any = torch.cat([first, second], -1)
        going_on = ~data["next", "done"][:, :-1, 0]
        assert (~going_on).any()
        following = data["next", "observation"][:, :-1]
        assert torch.equal(following[going_on], data["observation"][:, 1:][going_on])
        count = data["next", "step_count"][..., 0]
        assert torch.equal(count[:, 1:][going_on], count[:, :-1][going_on] + 1)

    def test_advantages_are_computed_along_time(self, collected: Any) -> None:
        """They equal the recursion, written out."""
        data: Any = collected[0][0].clone()
        critic = make_critic(RunningNormalizer(64), PolicyShape())
        estimate = GAE(gamma=0.9, lmbda=0.8, value_network=critic, deactivate_vmap=True)
        with torch.no_grad():
            estimate(data)
            now = critic(data.select("observation"))["state_value"]
            following = critic(data["next"].select("observation"))["state_value"]
        after = data["next"]
        delta = after["reward"] + 0.9 * following * ~after["terminated"] - now
        advantage, running = torch.zeros_like(delta), torch.zeros(ROBOTS, 1)
        for t in reversed(range(delta.shape[1])):
            running = delta[:, t] + 0.9 * 0.8 * running * ~after["done"][:, t]
            advantage[:, t] = running
        torch.testing.assert_close(data["advantage"], advantage)

    def test_each_collector_draws_other_numbers(self, collected: Any) -> None:
        data, half = collected[0][0], ROBOTS // 2
        noise = data["action"] - data["action"].mean(0)
        assert not torch.equal(noise[:half], noise[half:])
        assert not torch.equal(data["observation"][:half, 0], data["observation"][half:, 0])


@needs_ray
@pytest.mark.slow
def test_the_same_seed_gives_the_same_batches(distributed: Any, ray: Any) -> None:
    """Bit for bit, with both kinds of collectors."""
    for one, other in zip(distributed[0], ray[0], strict=True):
        assert differing(one, other) == []


# --------------------------------------------------------------------- trainings


def _cluster(backend: Any, **settings: Any) -> ClusterConfig:
    """Settings of a tiny training."""
    return ClusterConfig(**{**vars(TINY), "backend": backend, **settings})


def _rows(folder: Path) -> list[list[float]]:
    """Rows of a run, without durations."""
    columns = [column for name, column in read_progress(folder).items() if name != "elapsed_s"]
    return list(map(list, zip(*columns, strict=True)))


@pytest.mark.slow
def test_a_training_whose_collector_was_killed_can_resume(tmp_path: Path) -> None:
    """An error names the cause, files are complete, and no process is left running."""
    config = _cluster("distributed", out=tmp_path / "run", total_steps=192, preset="robust")
    update = ppo_aslip.update

    def killing(*args: Any) -> Any:
        if len(_rows(config.out)) == 1:
            children = multiprocessing.active_children()
            assert len(children) == 2
            os.kill(int(children[1].pid or 0), signal.SIGKILL)
        return update(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules["ppo_aslip"], "update", killing)
        with pytest.raises(TrainingStoppedError, match=r"CollectorError.*--resume continues"):
            train_on_cluster(config)
    assert multiprocessing.active_children() == []
    before = _rows(config.out)
    assert [row[0] for row in before] == [64, 128]
    train_on_cluster(replace(config, resume=True))
    after = _rows(config.out)
    assert [row[0] for row in after] == [64, 128, 192]
    assert repr(after[:2]) == repr(before)  # NaN where nothing was evaluated
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@needs_ray
def test_a_training_with_ray_leaves_nothing_running(tmp_path: Path) -> None:
    """Two updates, with domain randomisation."""
    config = _cluster("ray", out=tmp_path / "run", preset="robust")
    train_on_cluster(config)
    assert [row[0] for row in _rows(config.out)] == [64, 128]
    assert not importlib.import_module("ray").is_initialized()


_TRAINING = """
import sys
from pathlib import Path

from recipes.ppo_cluster import ClusterConfig, main
from tests.helpers import TINY

if __name__ == "__main__":
    settings = dict(out=Path(sys.argv[1]), total_steps=10**6, eval_interval=10**6)
    main(ClusterConfig(**{**vars(TINY), "backend": sys.argv[2], **settings}))
"""


def _session(leader: int) -> list[str]:
    """Processes in the session of a process."""
    command = ["ps", "-s", str(leader), "-o", "stat=,args="]
    listed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [line for line in listed.splitlines() if not line.startswith("Z")]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize(
    "kind", ["distributed", pytest.param("ray", marks=[needs_ray, pytest.mark.slow])]
)
def test_all_processes_end_however_a_training_ends(
    tmp_path: Path, kind: str, number: signal.Signals
) -> None:
    script, out = tmp_path / "train.py", tmp_path / "run"
    script.write_text(_TRAINING)
    training = subprocess.Popen(
        [sys.executable, str(script), str(out), kind],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [os.getcwd(), *sys.path]))},
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        _wait(lambda: len(_rows(out)) > 1)
        assert len(_session(training.pid)) > 2
        # to all processes, as a terminal does; Ray's own ignore it
        os.killpg(training.pid, number) if number == signal.SIGINT else training.send_signal(number)
        training.wait(120)
        _wait(lambda: not _session(training.pid))
        assert list((out / "checkpoints").glob("checkpoint-*"))
    finally:
        training.kill()
        training.wait()


def _wait(over: Callable[[], bool], seconds: float = 150.0) -> None:
    """Wait for a condition; two agents of Ray need a minute to notice that Ray was killed."""
    start = time.monotonic()
    while not over():
        assert time.monotonic() - start < seconds
        time.sleep(0.2)


class Sender:
    """Collector that sends its policy away before each batch."""

    def __init__(self, make_env: Any, actor: torch.nn.Module, **settings: Any) -> None:
        self._local, self._actor = LocalCollector(make_env, actor, **settings), actor

    def __iter__(self) -> Iterator[TensorDict]:
        batches = iter(self._local)
        while True:
            pickle.dumps(self._actor)
            yield next(batches)

    def __enter__(self) -> Sender:
        return self

    def __exit__(self, *exception: object) -> None:
        self._local.shutdown()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._local, name)


def test_a_training_can_send_its_policy_to_other_processes(tmp_path: Path) -> None:
    ppo_aslip.main(replace(TINY, out=tmp_path / "run"), make_collector=Sender)
    assert read_progress(tmp_path / "run")["step"] == [64, 128]


# ---------------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_collectors": 3}, "num_envs must be a multiple of num_collectors = 3, got 4"),
        ({"num_collectors": 0}, "num_collectors must be 1 or more, got 0"),
        ({"samples": 30}, "samples must be a multiple of num_envs = 4, got 30"),
        ({"device": "cuda"}, "need device='cpu', got cuda"),
    ],
)
def test_unequal_shares_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        _collector(**{"kind": "distributed", "actor": torch.nn.Identity(), **change})


def test_the_recipe_refuses_unequal_shares_at_once() -> None:
    with pytest.raises(ConfigurationError, match="multiple of num_collectors = 3, got 8"):
        _cluster("distributed", num_collectors=3)


def test_a_cluster_that_cannot_be_joined_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Ray:
        @staticmethod
        def is_initialized() -> bool:
            return False

        @staticmethod
        def init(**settings: Any) -> None:
            raise ConnectionError(f"no one at {settings['address']}")

        shutdown = is_initialized

    monkeypatch.setenv("RAY_ADDRESS", "somewhere:1")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: "there")
    monkeypatch.setitem(sys.modules, "ray", Ray)
    collector = _collector("ray", torch.nn.Identity())
    with collector, pytest.raises(ConfigurationError, match=r"'somewhere:1'.*no one at"):
        next(iter(collector))


@pytest.mark.parametrize(
    ("processors", "collectors", "threads"),
    [([8], 2, 4), ([8], 3, 2), ([2, 6], 2, 3), ([4, 4], 3, 2), ([1, 1, 1], 3, 1), ([0, 4], 1, 4)],
)
def test_every_collector_gets_the_largest_number_of_threads_that_fits_all(
    processors: list[int], collectors: int, threads: int
) -> None:
    assert threads_each(processors, collectors) == threads


def test_more_collectors_than_processors_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="at most 4, the processors of the Ray cluster"):
        threads_each([2, 2], 5)


def test_a_resumed_collector_draws_other_numbers() -> None:
    """They differ from all numbers drawn before, by this collector or another."""
    seeds: set[tuple[int, int]] = set()
    for batches in range(3):
        collector = _collector("distributed", torch.nn.Identity())
        collector.load_state_dict({"batches": batches})
        assert collector.state_dict() == {"batches": batches}
        seeds |= {(robots.env_seed, robots.torch_seed) for robots in collector._robots(1)}
    assert len(seeds) == 6
