"""Robots that are not simulated, and stacks of transforms around them."""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import check_env_specs

import aslip
from aslip.envs import BatchEnv, RobotEnv, StackEnv, default_stack, robot_stack
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE
from aslip.training.collectors import LocalCollector
from tests.helpers import differing

STEPS = 30


class ReplayedRobot(RobotEnv):
    """Robots that send the packets of a log, independent of their motor targets.

    Args:
        log: sensor -> packets (m, n, W, k) of m policy steps, the reset's first.
    """

    def __init__(self, log: Mapping[str, np.ndarray]) -> None:
        self.log, self.tick = log, 0
        self.targets: list[np.ndarray] = []
        super().__init__(log["gyro"].shape[1])

    def track(self, motor_target: np.ndarray) -> np.ndarray:
        self.tick += 1
        self.targets.append(motor_target.copy())
        return np.full(self.num_envs, self.tick == len(self.log["gyro"]) - 1)

    def restart(self, robots: np.ndarray) -> None:
        self.tick = 0

    def packets(self) -> Mapping[str, np.ndarray]:
        return {name: packets[self.tick] for name, packets in self.log.items()}


def _rollout(env: StackEnv) -> TensorDictBase:
    start = TensorDict(command=torch.tensor([[0.5], [1.0]]), phase=torch.zeros(2, 1), batch_size=2)
    with torch.no_grad():
        return env.rollout(
            STEPS,
            aslip.load_policy("straight"),
            tensordict=env.reset(start),
            auto_reset=False,
            break_when_any_done=False,
        )


@pytest.fixture(scope="module")
def walk() -> TensorDictBase:
    """A simulated walk without the simulator's truth in the stack."""
    env = aslip.make_env(
        base=BatchEnv, num_envs=2, stack=robot_stack(), drop=["low_reward"], seed=0
    )
    return _rollout(env)


@pytest.fixture
def log(walk: TensorDictBase) -> dict[str, np.ndarray]:
    first = walk["sensors"][:, :1]
    packets = cast("TensorDictBase", torch.cat([first, walk["next", "sensors"]], dim=1))
    return {name: np.asarray(packets[name].transpose(0, 1)) for name in CASSIE.packet_sizes}


def test_replayed_logs_give_the_motor_targets_of_the_walk(
    walk: TensorDictBase, log: dict[str, np.ndarray]
) -> None:
    robot = ReplayedRobot(log)
    env = aslip.make_env(base=robot, stack=robot_stack(), drop=["low_reward"], seed=0)
    again = _rollout(env)
    assert "truth" not in again
    # the last step ends the log
    assert not differing(again[:, :-1], walk.exclude("truth", ("next", "truth"))[:, :-1])
    targets = walk["reference", "motor_target"] + walk["action"]
    assert np.array_equal(np.stack(robot.targets, axis=1), np.asarray(targets, dtype=np.float64))
    assert again["next", "terminated"][:, -1].all()
    assert not again["next", "terminated"][:, :-1].any()
    # the estimator's odometry has moved forward
    assert (again["next", "odometry", "pelvis_position"][:, -1, 0] > 0.1).all()


def test_robots_keep_the_contract_of_torchrl(log: dict[str, np.ndarray]) -> None:
    check_env_specs(ReplayedRobot(log))
    check_env_specs(aslip.make_env(base=ReplayedRobot(log), stack=robot_stack(), seed=0))


def test_robot_stack_has_no_transform_that_needs_a_simulation() -> None:
    left_out = default_stack().keys() - robot_stack().keys()
    assert left_out == {"start", "heading", "noise", "fall"}
    on_truth = default_stack().keys() - robot_stack(default_stack()).keys()
    assert on_truth - left_out == {"com_vel", "foot_pos", "straight_diff", "foot_orient"}


@pytest.mark.parametrize(
    ("drop", "name"),
    [((), "'start' .ReferenceStart."), (("start",), "'heading' .HeadingFrame.")],
)
def test_transforms_that_need_a_simulation_are_named(
    log: dict[str, np.ndarray], drop: Sequence[str], name: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"{name} needs.*ReplayedRobot.*robot_stack"):
        aslip.make_env(base=ReplayedRobot(log), drop=drop)


@pytest.mark.parametrize("settings", [{"num_threads": 2}, {"timestep": 0.001}, {"num_envs": 3}])
def test_settings_of_a_simulator_are_refused_with_a_base(
    log: dict[str, np.ndarray], settings: dict[str, float]
) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        aslip.make_env(base=ReplayedRobot(log), stack=robot_stack(), **settings)  # pyright: ignore


@pytest.mark.parametrize("key", ["initial", "dynamics", "push"])
def test_requests_for_simulations_are_refused(log: dict[str, np.ndarray], key: str) -> None:
    env = ReplayedRobot(log)
    ask = env.step if key == "push" else env.reset
    request = env.reset().set("motor_target", torch.zeros(2, 10))
    with pytest.raises(ConfigurationError, match=f"{key!r} is for simulated robots"):
        ask(request.set(key, torch.zeros(2, 3)))


@pytest.mark.parametrize("wrong", ["missing", "short"])
def test_packets_of_wrong_shape_are_refused(log: dict[str, np.ndarray], wrong: str) -> None:
    log["gyro"] = log["gyro"][:, :, : CASSIE.sensor_window // 2]
    env = ReplayedRobot(log)
    if wrong == "missing":
        env.packets = lambda: {k: v[0] for k, v in log.items() if k != "gyro"}
    with pytest.raises(ShapeError, match="'gyro' must have shape"):
        env.reset()


def test_collector_on_replayed_robots_saves_and_loads(log: Mapping[str, np.ndarray]) -> None:
    """Robots that are not simulated begin a new episode; everything else resumes."""

    def make(**settings: int) -> StackEnv:
        del settings
        return aslip.make_env(base=ReplayedRobot(log), stack=robot_stack(), seed=0)

    policy = cast("torch.nn.Module", aslip.load_policy("straight"))
    first, second = (LocalCollector(make, policy, num_envs=2, samples=8) for _ in range(2))
    next(iter(first))
    second.load_state_dict(first.state_dict())
    assert next(iter(second)).numel() == 8
    first.shutdown()
    second.shutdown()
