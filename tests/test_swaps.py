"""Swaps of every part in under 40 lines each, from public names only.

Each example is a function to copy: it trains, and returns its `make_env`. The tests load each
policy, walk with it, and pass it to a benchmark. `docs/swapping.md` explains the parts.
"""

import ast
import importlib
import inspect
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Composite, LazyTensorStorage, ReplayBuffer
from torchrl.envs.transforms import CatFrames
from torchrl.envs.utils import step_mdp
from torchrl.modules import MLP, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

import aslip
from aslip.envs import BatchEnv, StackEnv, default_stack, insert_before, robot_stack
from aslip.errors import ConfigurationError
from aslip.policy import (
    MakeActor,
    PolicyShape,
    RunningNormalizer,
    add_memory,
    make_recurrent_actor,
    policy_interface,
    read_card,
    save_policy,
)  # fmt: skip
from aslip.robot import CASSIE
from aslip.sim import Torque
from aslip.training.progress import read_progress
from aslip.transforms import ActionDelta, SeededTransform, WeightedReward, extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import Walker
from benchmarks.paper import velocity_tracking
from recipes import ppo_aslip, sac_aslip
from recipes.ppo_aslip import Config
from tests import helpers

MakeEnv = Callable[..., StackEnv]

# ------------------------------------------------------------------------ examples


def train_with_air_time(config: Config) -> MakeEnv:
    """Reward with memory: a penalty on the time since a foot last carried weight."""
    term = ("reward_terms", "air_time")

    class AirTime(SeededTransform):
        """Time in the air of each foot (n, 2) and the longer of both [s]."""

        def __init__(self) -> None:
            super().__init__(in_keys=[("truth", "ground_force")], out_keys=["air_time", term])

        def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> Any:
            n = len(tensordict_reset)
            return tensordict_reset.set("air_time", torch.zeros(n, 2)).set(term, torch.zeros(n, 1))

        def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> Any:
            swings = next_tensordict["truth", "ground_force"][..., 2] < 20.0  # (n, 2 feet) [N]
            air = torch.where(swings, tensordict["air_time"] + 0.03, 0.0)
            return next_tensordict.set("air_time", air).set(term, air.amax(-1, keepdim=True))

        def transform_observation_spec(self, observation_spec: Composite) -> Composite:
            return extend_spec(observation_spec, {"air_time": 2, term: 1})

    stack = insert_before(default_stack(), "reward", air_time=AirTime())
    stack["reward"] = WeightedReward({**PAPER_WEIGHTS, "air_time": -0.1})
    make_env = partial(aslip.make_env, stack=stack)
    ppo_aslip.main(config, make_env)
    return make_env


def train_with_history(config: Config) -> MakeEnv:
    """History: the last three observations instead of one."""
    stack = insert_before(
        default_stack(), "action", history=CatFrames(3, -1, in_keys=["observation"])
    )
    make_env = partial(aslip.make_env, stack=stack)
    # the mirror image that makes the default network symmetric is that of one observation
    ppo_aslip.main(replace(config, symmetric=False), make_env)
    return make_env


def train_recurrent_policy(config: Config) -> MakeEnv:
    """GRU instead of the perceptron."""
    ppo_aslip.main(
        replace(config, symmetric=False), make_actor=make_recurrent_actor, network={"hidden": (32,)}
    )
    return aslip.make_env


def train_with_torques(config: Config) -> MakeEnv:
    """Torques instead of angles: actions are added to the reference's motor torques."""
    stack = default_stack()
    del stack["feedforward"]
    stack["action"] = ActionDelta(("reference", "motor_torque"), limit=50.0)
    make_env = partial(aslip.make_env, base=partial(BatchEnv, drive=Torque), stack=stack)
    config = replace(config, std=5.0, last_std=2.0)  # [N m]
    ppo_aslip.main(replace(config, physics_timestep=CASSIE.physics_timestep), make_env)
    return make_env


def train_with_sac(config: Config) -> MakeEnv:
    """Soft actor-critic instead of PPO; `recipes/sac_aslip.py` also logs and normalises."""
    stack = default_stack()
    stack["action"] = ActionDelta(("reference", "motor_target"), limit=0.4)
    make_env = partial(aslip.make_env, stack=stack)
    env = make_env(num_envs=config.num_envs, keep=["observation"], seed=0)
    spec = env.action_spec_unbatched
    shape = PolicyShape(env.observation_spec["observation"].shape[-1], spec.shape[-1])
    actor = sac_aslip.make_actor(RunningNormalizer(shape.observation_size), shape)
    values = MLP(shape.observation_size + shape.action_size, 1, num_cells=[64, 64])
    critic = ValueOperator(values, in_keys=["observation", "action"])
    loss = SACLoss(actor, critic, action_spec=spec)
    loss.make_value_estimator(gamma=config.gamma)
    target = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    buffer = ReplayBuffer(storage=LazyTensorStorage(config.total_steps), batch_size=32)
    collector = Collector(
        env, actor, frames_per_batch=config.samples, total_frames=config.total_steps
    )
    for data in collector:
        buffer.extend(data.reshape(-1).select(*sac_aslip.STORED))
        losses = loss(buffer.sample())
        optimizer.zero_grad()
        (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
        optimizer.step()
        target.step()
    config.out.mkdir()
    interface = policy_interface(make_env(seed=0))
    path = config.out / "policy.zip"
    save_policy(path, actor, shape, network=sac_aslip.make_actor, **interface)
    return make_env


def replay_packets(file: Path) -> MakeEnv:
    """Robot without a simulator: it sends the packets of a file, independent of its targets."""

    class RecordedRobot(aslip.RobotEnv):
        """Robots that send recorded packets (steps, W, k) by name."""

        def __init__(self, num_envs: int = 1) -> None:
            self.recorded: dict[str, np.ndarray] = dict(np.load(file))
            self.tick = np.zeros(num_envs, dtype=int)
            super().__init__(num_envs)

        def restart(self, robots: np.ndarray) -> None:
            self.tick[robots] = 0

        def track(self, motor_target: np.ndarray) -> np.ndarray:
            last = len(self.recorded["gyro"]) - 1
            self.tick = np.minimum(self.tick + 1, last)
            return self.tick == last  # the robot has stopped

        def packets(self) -> dict[str, np.ndarray]:
            return {name: packets[self.tick] for name, packets in self.recorded.items()}

    return partial(aslip.make_env, base=RecordedRobot, stack=robot_stack())


# --------------------------------------------------------------------------- tests

TINY = replace(
    helpers.TINY, num_envs=4, samples=16, total_steps=32, minibatch=16, checkpoint_minutes=9
)
# examples that train, and the network function if it is not built in
TRAININGS: list[tuple[Callable[[Config], MakeEnv], MakeActor | None]] = [
    (train_with_air_time, None),
    (train_with_history, None),
    (train_recurrent_policy, None),
    (train_with_torques, None),
    (train_with_sac, sac_aslip.make_actor),
]
every_training = pytest.mark.parametrize(
    ("train", "network"), TRAININGS, ids=[train.__name__ for train, _ in TRAININGS]
)

Trained = Callable[[Callable[[Config], MakeEnv]], tuple[Path, MakeEnv]]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """Function that trains an example once; returns its run folder and `make_env`."""
    done: dict[Any, tuple[Path, MakeEnv]] = {}

    def train_once(train: Callable[[Config], MakeEnv]) -> tuple[Path, MakeEnv]:
        if train not in done:
            folder = tmp_path_factory.mktemp("runs") / "run"
            done[train] = folder, train(replace(TINY, out=folder))
        return done[train]

    return train_once


# one second instead of a minute, long enough for a touchdown of the model
SHORT: dict[str, Any] = {"hold": 0.15, "transient": 0.03, "settle": 0.09, "walk": 0.09}


def _rollout(make_env: MakeEnv, policy: Any, steps: int = 12) -> Any:
    """Policy steps (steps, ...) of one robot at 0.5 m/s, continued after falls."""
    with closing(make_env(num_envs=1, seed=0)) as env, torch.no_grad():
        start = TensorDict(command=torch.tensor([[0.5]]), batch_size=1)
        start = add_memory(env, policy).reset(start)
        return env.rollout(
            steps, policy, tensordict=start, auto_reset=False, break_when_any_done=False
        )[0]


@every_training
def test_an_example_trains_saves_loads_walks_and_is_measured(
    train: Any, network: MakeActor | None, trained: Trained, tmp_path: Path
) -> None:
    folder, make_env = trained(train)
    policy = aslip.load_policy(folder, network)
    assert all(value.isfinite().all() for value in policy.state_dict().values())
    with closing(make_env(seed=0)) as env:
        walker = Walker(policy if network else folder, env)
        assert walker.step()["next", "reward"].isfinite().all()
    config = velocity_tracking.Config(out=tmp_path, speeds=(0.5,), **SHORT)
    measured = velocity_tracking.main(config, policy if network else folder, make_env)
    assert [row["survived"] for row in measured["map"]] == [[True]]
    assert -1 < measured["map"][0]["mean"] < 2


@pytest.mark.parametrize("train", [train for train, network in TRAININGS if network is None])
def test_ppo_updates_the_policy_of_an_example(train: Any, trained: Trained) -> None:
    progress = read_progress(trained(train)[0])
    assert progress["step"] == [16, 32]
    assert max(map(abs, progress["kl_approx"])) > 0
    assert np.isfinite(progress["episode_return"]).all()


def test_a_reward_with_memory_counts_time_since_the_last_contact(trained: Trained) -> None:
    folder, make_env = trained(train_with_air_time)
    walk = _rollout(make_env, aslip.load_policy(folder))
    after, in_air, expected = walk["next"], torch.zeros(2), []
    for force in after["truth", "ground_force"][..., 2]:
        in_air = torch.where(force < 20.0, in_air + CASSIE.policy_period, 0.0)
        expected.append(in_air.max())
    term = after["reward_terms", "air_time"][:, 0]
    torch.testing.assert_close(term, torch.stack(expected))
    assert len(term.unique()) > 3
    others = sum(weight * after["reward_terms", name] for name, weight in PAPER_WEIGHTS.items())
    torch.testing.assert_close(after["reward"][:, 0], (others[:, 0] - 0.1 * term))
    assert "term_air_time" in read_progress(folder)


def test_a_history_reaches_the_policy_and_is_required(trained: Trained) -> None:
    folder, make_env = trained(train_with_history)
    observed = _rollout(make_env, aslip.load_policy(folder))["observation"]
    assert torch.equal(observed[2:, :64], observed[:-2, 128:])
    with closing(aslip.make_env(seed=0)) as env, pytest.raises(ConfigurationError, match="192"):
        Walker(folder, env)


def test_a_recurrent_policy_remembers(trained: Trained) -> None:
    folder, make_env = trained(train_recurrent_policy)
    assert read_card(folder)["network"] == "gru"
    walk = _rollout(make_env, aslip.load_policy(folder))
    assert walk["memory"].flatten(1).any(1).tolist() == [False] + 11 * [True]


def test_torques_reach_the_motors(trained: Trained) -> None:
    folder, make_env = trained(train_with_torques)
    walk = _rollout(make_env, aslip.load_policy(folder), steps=3)
    sent = walk["reference", "motor_torque"] + walk["action"]
    torch.testing.assert_close(walk["next", "truth", "motor_torque"], sent, atol=1e-3, rtol=1e-4)
    assert sent.abs().max() > 1.0


def test_sac_acts_within_its_bounds(trained: Trained) -> None:
    policy = aslip.load_policy(trained(train_with_sac)[0], sac_aslip.make_actor)
    for parameter in policy.parameters():
        parameter.mul_(1000)
    observation = TensorDict(observation=torch.randn(50, 64), batch_size=50)
    assert policy(observation)["action"].abs().max() == pytest.approx(0.4, abs=1e-3)


def test_a_robot_without_a_simulator_walks_and_is_measured(tmp_path: Path) -> None:
    """Policy and controller give the actions of the recorded walk."""
    policy, library = aslip.load_policy("straight"), aslip.GaitLibrary.load()
    simulated = partial(aslip.make_env, base=BatchEnv, stack=robot_stack())
    walk = _rollout(simulated, policy, steps=20)
    packets = torch.cat([walk["sensors"][:1], walk["next", "sensors"]]).to_dict()
    np.savez(tmp_path / "packets.npz", **packets)

    make_env = replay_packets(tmp_path / "packets.npz")
    replayed = _rollout(make_env, policy, steps=20)
    assert torch.equal(replayed["action"], walk["action"])
    assert "truth" not in replayed

    robot = make_env(num_envs=1, seed=0).base_env
    controller = aslip.Controller("straight", library)
    td = robot.reset()
    state = controller.start(td["sensors"], command=0.5, phase=walk["phase"][:1])
    for i in range(20):
        target = walk["reference", "motor_target"][i] + walk["action"][i]
        assert torch.equal(state.motor_target[0], target)
        td = step_mdp(robot.step(td.set("motor_target", state.motor_target)))
        state, _ = controller.step(state, td["sensors"])

    config = velocity_tracking.Config(out=tmp_path, speeds=(0.5,), **SHORT)
    (measured,) = velocity_tracking.main(config, "straight", make_env)["map"]
    assert measured["survived"] == [True]
    assert 0 < measured["mean"] < 1


@pytest.mark.parametrize("example", [*(train for train, _ in TRAININGS), replay_packets])
def test_an_example_has_less_than_40_lines(example: Callable[..., MakeEnv]) -> None:
    assert len(inspect.getsource(example).splitlines()) < 40


def test_examples_use_public_names_only() -> None:
    """Public names are those in `__all__`, and those that the docs import."""
    private = []
    for node in ast.walk(ast.parse(Path(__file__).read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("aslip."):
            listed = getattr(importlib.import_module(str(node.module)), "__all__", None)
            names = [alias.name for alias in node.names]
            private += [name for name in names if listed is None or name not in listed]
    assert private == ["ConfigurationError", "read_progress", "PAPER_WEIGHTS"]
