"""Robots in Ray actors: samples, weights, trainings on two nodes, and the end of the processes."""

import importlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ProbabilisticActor

import aslip
from aslip.envs import StackEnv, default_stack, insert_before
from aslip.errors import CollectorError, ConfigurationError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, set_std
from aslip.training.collectors import LocalCollector
from aslip.training.progress import read_progress
from aslip.training.ray import RayCollectors, threads_each
from aslip.training.run import TrainingStoppedError
from aslip.transforms import Difficulty
from recipes import ppo_aslip, ppo_directions
from recipes.ppo_directions import DirectionConfig
from recipes.ppo_settings import Config
from tests.helpers import TINY, differing

ROBOTS, SAMPLES = 4, 32

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed"
)


@dataclass
class Learner:
    """Actor and normaliser, with a stand-in for training."""

    actor: ProbabilisticActor
    normalizer: RunningNormalizer

    @classmethod
    def make(cls) -> "Learner":
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


def _collector(kind: Callable[..., Any], actor: torch.nn.Module, **settings: Any) -> Any:
    settings = {"num_envs": ROBOTS, "samples": SAMPLES, "seed": 3, **settings}
    return kind(aslip.make_env, actor, **settings)


def _batches(before: int = 0) -> tuple[list[TensorDict], list[float]]:
    """Two batches with learning in between, and errors of their log-probabilities."""
    learner, batches, errors = Learner.make(), [], []
    with _collector(RayCollectors, learner.actor) as collector:
        collector.load_state_dict({"batches": before})
        for data in collector:
            batches.append(data)
            errors.append(float((learner.log_prob(data) - data["action_log_prob"]).abs().max()))
            learner.learn(data)
            if len(batches) == 2:
                break
        assert collector.state_dict() == {"batches": before + 2}
    return batches, errors


@pytest.fixture(scope="module")
def collected() -> tuple[list[TensorDict], list[float]]:
    """Batches of a Ray of our own, which is stopped."""
    found = _batches()
    assert not importlib.import_module("ray").is_initialized()
    return found


@pytest.mark.slow
@needs_ray
class TestSamples:
    def test_weights_and_normaliser_arrive(self, collected: Any) -> None:
        """Log-probabilities are those of the actor at the time of the request."""
        batches, errors = collected
        assert errors == pytest.approx([0.0, 0.0], abs=1e-5)
        # those of the previous actor differ
        stale = Learner.make()
        assert (stale.log_prob(batches[1]) - batches[1]["action_log_prob"]).abs().max() > 0.1

    def test_batches_are_like_those_of_this_process(self, collected: Any) -> None:
        actor = Learner.make().actor
        with _collector(LocalCollector, actor) as collector:
            single = next(iter(collector))
        sent = {key for key in _collector(RayCollectors, actor).sent if key in single.keys(True)}
        for data in collected[0]:
            assert data.shape == single.shape == (ROBOTS, SAMPLES // ROBOTS)
            assert data.names == single.names
            kept = single.select(*sent)
            assert set(data.keys(True, True)) == set(kept.keys(True, True))
            for key in kept.keys(True, True):
                assert (data[key].shape, data[key].dtype) == (kept[key].shape, kept[key].dtype)

    def test_rows_are_robots_through_time(self, collected: Any) -> None:
        """`next` of a step equals the following step, also across batches."""
        data: Any = torch.cat(collected[0], -1)
        going_on = ~data["next", "done"][:, :-1, 0]
        assert (~going_on).any()
        following = data["next", "observation"][:, :-1]
        assert torch.equal(following[going_on], data["observation"][:, 1:][going_on])
        count = data["next", "step_count"][..., 0]
        assert torch.equal(count[:, 1:][going_on], count[:, :-1][going_on] + 1)

    def test_each_actor_draws_other_numbers(self, collected: Any) -> None:
        data, half = collected[0][0], ROBOTS // 2
        noise = data["action"] - data["action"].mean(0)
        assert not torch.equal(noise[:half], noise[half:])
        assert not torch.equal(data["observation"][:half, 0], data["observation"][half:, 0])


# --------------------------------------------------------------------- trainings


class Selecting(LocalCollector):
    """Collector in this process, of the entries that `RayCollectors` would send."""

    def __init__(self, make_env: Any, actor: Any, **settings: Any) -> None:
        self._sent = RayCollectors(make_env, actor, **settings).sent
        for name in ("keys", "num_collectors"):
            del settings[name]
        super().__init__(make_env, actor, **settings)

    def __iter__(self) -> Iterator[TensorDict]:
        for data in super().__iter__():
            yield data.select(*self._sent, strict=False)


@needs_ray
@pytest.mark.parametrize("recipe", [ppo_aslip, ppo_directions])
def test_the_entries_that_are_sent_suffice_to_learn(
    recipe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the privileged critic, too."""
    monkeypatch.setattr("aslip.training.ray.RayCollectors", Selecting)
    make = DirectionConfig if recipe is ppo_directions else Config
    given = {name: value for name, value in vars(TINY).items() if value is not None}
    recipe.main(make(**{**given, "num_collectors": 2, "out": tmp_path / "run"}))
    assert read_progress(tmp_path / "run")["step"] == [64, 128]


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Ray cluster of two nodes on this machine, with room for one actor each."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    # the nodes import the recipes, as on machines with a checkout
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [os.getcwd(), *sys.path])))
    node = {"num_cpus": 1, "include_dashboard": False, "object_store_memory": 2**29}
    cluster = importlib.import_module("ray.cluster_utils").Cluster(True, head_node_args=node)
    try:
        cluster.add_node(num_cpus=1, object_store_memory=2**29)
        cluster.wait_for_nodes()
        monkeypatch.setenv("RAY_ADDRESS", cluster.address)
        yield cluster
    finally:
        importlib.import_module("ray").shutdown()
        cluster.shutdown()


@needs_ray
@pytest.mark.slow
def test_recipes_train_on_two_nodes_and_resume_without_one_of_them(
    cluster: Any, collected: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Same samples as on one node; a lost node ends a training with an error."""
    for one, other in zip(_batches()[0], collected[0], strict=True):
        assert differing(one, other) == []
    for one, other in zip(_batches(2)[0], collected[0], strict=True):
        assert not torch.equal(one["action"], other["action"])

    ppo_aslip.main(replace(TINY, num_collectors=2, out=tmp_path / "straight"))
    assert read_progress(tmp_path / "straight")["step"] == [64, 128]

    update, lost = ppo_aslip.update, cluster.list_all_nodes()[1]

    def losing(*args: Any) -> Any:
        if len(read_progress(config.out).get("step", [])) == 1:
            cluster.remove_node(lost, allow_graceful=False)
            ray = importlib.import_module("ray")
            _wait(lambda: sum(node["Alive"] for node in ray.nodes()) == 1)  # or it gets the actor
        return update(*args)

    changes = {"num_collectors": 2, "out": tmp_path / "run", "total_steps": 192}
    config = DirectionConfig(**{**vars(TINY), **changes})
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules["ppo_aslip"], "update", losing)
        with pytest.raises(TrainingStoppedError, match=r"CollectorError.*; saved: "):
            ppo_directions.main(config)
    assert read_progress(config.out)["step"] == [64, 128]
    ppo_directions.main(replace(config, resume=True, num_collectors=1))
    assert read_progress(config.out)["step"] == [64, 128, 192]


_TRAINING = """
import sys
from dataclasses import replace
from pathlib import Path

from recipes.ppo_aslip import main
from tests.helpers import TINY

if __name__ == "__main__":
    settings = dict(out=Path(sys.argv[1]), total_steps=10**6, eval_interval=10**6)
    main(replace(TINY, num_collectors=2, **settings))
"""


def _session(leader: int) -> list[str]:
    """Processes in the session of a process."""
    command = ["ps", "-s", str(leader), "-o", "stat=,args="]
    listed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [line for line in listed.splitlines() if not line.startswith("Z")]


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_all_processes_end_however_a_training_ends(tmp_path: Path, number: signal.Signals) -> None:
    script, out = tmp_path / "train.py", tmp_path / "run"
    script.write_text(_TRAINING)
    training = subprocess.Popen(
        [sys.executable, str(script), str(out)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [os.getcwd(), *sys.path]))},
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        _wait(lambda: len(read_progress(out).get("step", [])) > 1)
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


@needs_ray
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_collectors": 3}, "num_envs must be a multiple of num_collectors = 3, got 4"),
        ({"samples": 30}, "samples must be a multiple of num_envs = 4, got 30"),
        ({"device": "cuda"}, "need device='cpu', got cuda"),
    ],
)
def test_unequal_shares_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        _collector(RayCollectors, torch.nn.Identity(), **change)
    if change.get("num_collectors"):  # by a recipe's settings, too
        with pytest.raises(ConfigurationError, match="multiple of num_collectors = 3, got 8"):
            replace(TINY, **change)


@needs_ray
@pytest.mark.parametrize("state", [{"batches": 5}, {"torchrl": {"frames": 5 * SAMPLES}}])
def test_resumed_robots_are_as_difficult_as_before(
    state: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After five batches, also of robots in one process; each robot took eight steps of each."""
    made: list[Callable[[], StackEnv]] = []
    stack = insert_before(default_stack(), "command", difficulty=Difficulty(100))
    collector = RayCollectors(
        partial(aslip.make_env, stack=stack), Learner.make().actor, num_envs=ROBOTS, samples=SAMPLES
    )
    ray = SimpleNamespace(
        is_initialized=lambda: True,
        nodes=lambda: [{"Alive": True, "Resources": {"CPU": 2.0}}],
        put=lambda value: value,
        get=lambda value: value,
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    collect = "aslip.training.ray.Collector"
    monkeypatch.setattr(collect, lambda makers, *_, **__: made.extend(makers))
    collector.load_state_dict(state)
    with pytest.raises(CollectorError, match="NoneType"):
        next(iter(collector))
    first, second = (make().reset() for make in made)
    found = torch.cat([first["difficulty"], second["difficulty"]])
    torch.testing.assert_close(found, torch.full((ROBOTS, 1), 0.4))
    assert not torch.equal(first["observation"], second["observation"])


def test_robots_of_ray_cannot_go_on_in_this_process() -> None:
    with (
        _collector(LocalCollector, Learner.make().actor) as collector,
        pytest.raises(ConfigurationError, match="in Ray actors; give it num_collectors"),
    ):
        collector.load_state_dict({"batches": 2})


@pytest.mark.parametrize(
    ("processors", "collectors", "threads"),
    [([8], 2, 4), ([8], 3, 2), ([2, 6], 2, 3), ([4, 4], 3, 2), ([1, 1, 1], 3, 1), ([0, 4], 1, 4)],
)
def test_every_collector_gets_the_largest_number_of_threads_that_fits_all(
    processors: list[int], collectors: int, threads: int
) -> None:
    assert threads_each(processors, collectors) == threads
