"""Robots on MuJoCo Warp, on its CPU device: they are those of the batch, in single precision."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
import warp
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs, step_mdp

import aslip
from aslip.envs import BatchEnv, SimulatedEnv, WarpEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.estimation import StateEstimator
from aslip.robot import CASSIE
from aslip.sim import DYNAMICS
from aslip.sim.course import Course, pattern
from aslip.sim.warp import check_device
from aslip.transforms import EstimatedState
from aslip.transforms.device_estimator import DeviceEstimator
from tests.helpers import STANDING as _QPOS

STANDING = _QPOS[CASSIE.indices.motor_qpos.copy()].float()

NUM = 4


class Own(StateEstimator):
    """Estimator of a user."""


@pytest.fixture(scope="module")
def robots() -> WarpEnv:
    """Robots without a stack; each test resets them."""
    return WarpEnv(NUM, device="cpu")


@pytest.fixture(autouse=True)
def nominal(robots: WarpEnv) -> Iterator[None]:
    """Leave nominal robots behind."""
    yield
    robots.set_dynamics(
        {name: p.nominal for name, p in DYNAMICS.items() if name != "floor_friction"}
    )
    robots.set_dynamics({"floor_friction": 0.8})
    robots.watch(None)


def _targets(num: int, steps: int, seed: int = 0, size: float = 0.2) -> Tensor:
    """(steps, n, 10) motor targets around the standing pose."""
    generator = torch.Generator().manual_seed(seed)
    return STANDING + size * torch.randn(steps, num, 10, generator=generator)


def _step(env: SimulatedEnv, target: Tensor, **entries: Any) -> TensorDict:
    td = TensorDict(motor_target=target, batch_size=env.num_envs, **entries)
    return env.step(td)["next"]


def _advance(env: SimulatedEnv, targets: Tensor) -> TensorDict:
    after = TensorDict()
    for target in targets:
        after = _step(env, target)
    return after


def test_environments_keep_their_specs(robots: WarpEnv) -> None:
    check_env_specs(robots, break_when_any_done="both")


def test_a_replayed_graph_equals_its_kernels(robots: WarpEnv) -> None:
    """Bit for bit over 600 substeps; operations that a capture cannot record drop out silently."""
    simulations, targets = robots.simulations, _targets(NUM, 10)
    robots.reset()
    _advance(robots, targets)
    captured = robots.states()
    robots.reset()
    for target in targets:
        simulations._live["target"].copy_(target)
        simulations._period()
    np.testing.assert_array_equal(robots.states(), captured)


def test_an_odd_number_of_replays_loses_nothing(robots: WarpEnv) -> None:
    robots.reset()
    _advance(robots, _targets(NUM, 3))
    three = robots.states()
    robots.reset()
    for target in _targets(NUM, 3):
        _step(robots, target)
        robots.set_states(robots.states())
    np.testing.assert_array_equal(robots.states(), three)


def test_equal_robots_stay_equal(robots: WarpEnv) -> None:
    robots.reset()
    _advance(robots, _targets(1, 10).expand(-1, NUM, -1))
    states = robots.states()
    np.testing.assert_array_equal(states, np.tile(states[:1], (NUM, 1)))


def test_a_reset_leaves_other_robots_untouched(robots: WarpEnv) -> None:
    """With delayed torques and the filters of the sensors."""
    robots.reset()
    _advance(robots, _targets(NUM, 5))
    before = robots.states()
    mask = torch.tensor([False, True, False, False])[:, None]
    robots.reset(TensorDict(_reset=mask, batch_size=NUM))
    after = robots.states()
    kept = [0, 2, 3]
    np.testing.assert_array_equal(after[kept], before[kept])
    robots.reset()
    np.testing.assert_array_equal(after[1], robots.states()[1])


def test_a_diverged_robot_ends_alone(robots: WarpEnv) -> None:
    targets = _targets(NUM, 4)
    robots.reset()
    _advance(robots, targets)
    sound, count = robots.states(), int(robots.divergences)
    robots.reset()
    bad = targets.clone()
    bad[-1, 2] = torch.nan
    after = _advance(robots, bad)
    assert after["terminated"][:, 0].tolist() == [False, False, True, False]
    assert int(robots.divergences) == count + 1
    kept = [0, 1, 3]
    np.testing.assert_array_equal(robots.states()[kept], sound[kept])
    assert torch.isfinite(after["truth", "qpos"]).all()


def test_a_walk_is_that_of_the_batch() -> None:
    """Positions differ by 1e-4 after a policy step, from single precision and contacts."""
    policy = aslip.load_policy("straight")
    batch = aslip.make_env(num_envs=NUM, seed=0)
    device = aslip.make_env("warp", device="cpu", num_envs=NUM, seed=0)
    td = batch.reset(TensorDict(command=torch.ones(NUM, 1), batch_size=NUM))
    device.reset(TensorDict(command=torch.ones(NUM, 1), batch_size=NUM))
    worst = []
    with torch.no_grad():
        for _ in range(20):
            device.base_env.set_states(batch.base_env.states())
            target = batch.transform.inv(policy(td.clone()))["motor_target"]
            there = _step(device.base_env, target)
            td = step_mdp(batch.step(policy(td)))
            worst.append(float((there["truth", "qpos"] - td["truth", "qpos"]).abs().max()))
            assert all(packets.isfinite().all() for packets in there["sensors"].values())
    assert np.median(worst) < 1e-4 and max(worst) < 1e-3, worst


def test_packets_are_those_of_the_batch(robots: WarpEnv) -> None:
    """Encoders, velocity filters, limits and IMU from the same states, to single precision.

    A count of an encoder may differ where its angle is at the edge of a count.
    """
    batch = BatchEnv(NUM, num_threads=1)
    batch.reset()
    targets = _targets(NUM, 6, size=0.1)
    _advance(batch, targets[:5])
    robots.reset()
    robots.set_states(batch.states())
    theirs, ours = (_step(env, targets[5]) for env in (batch, robots))
    limits = {
        "motor_position": 5e-4, "joint_position": 1e-3, "motor_velocity": 0.1,
        "joint_velocity": 0.1, "orientation": 1e-5, "gyro": 5e-3, "accelerometer": 0.2,
    }  # fmt: skip
    for name, limit in limits.items():
        difference = (ours["sensors", name][:, :3] - theirs["sensors", name][:, :3]).abs()
        assert float(difference.quantile(0.9)) < limit, name
    torch.testing.assert_close(
        ours["truth", "motor_power"], theirs["truth", "motor_power"], rtol=0.01, atol=2.0
    )


def test_the_first_packet_after_a_reset_is_of_the_new_state(robots: WarpEnv) -> None:
    batch = BatchEnv(NUM, num_threads=1)
    qpos = torch.tensor(batch.model.key("standing").qpos).repeat(NUM, 1)
    qpos[:, 7] += torch.linspace(-0.1, 0.1, NUM)
    _advance(robots, _targets(NUM, 2))
    request = TensorDict(initial=TensorDict(qpos=qpos, batch_size=NUM), batch_size=NUM)
    theirs, ours = batch.reset(request.clone()), robots.reset(request)
    for name in batch.robot.packet_sizes:
        torch.testing.assert_close(
            ours["sensors", name],
            theirs["sensors", name],
            rtol=1e-3,
            atol=0.05 if name == "accelerometer" else 2e-3,
        )


@pytest.mark.parametrize("timestep", [0.0005, 0.001])
def test_robots_of_other_dynamics_are_those_of_the_batch(robots: WarpEnv, timestep: float) -> None:
    """Each robot has its own values of all parameters; derived fields follow."""
    if timestep != robots.model.opt.timestep:
        robots = WarpEnv(NUM, device="cpu", timestep=timestep)
    batch = BatchEnv(NUM, num_threads=1, timestep=timestep)
    spread = torch.linspace(0.8, 1.2, NUM).numpy()
    values = {name: spread * p.nominal for name, p in DYNAMICS.items()}
    values |= {"payload": 10 * spread, "slope": 0.05 * spread, "torque_delay": 0.005 * spread}
    for env in (batch, robots):
        env.reset()
        env.set_dynamics(values)
        env.set_dynamics({"mass": 1.1}, np.array([1]))
    for name, ours in robots.dynamics.items():
        np.testing.assert_array_equal(ours, batch.dynamics[name])
    np.testing.assert_allclose(robots.weight, batch.weight)
    robots.set_states(batch.states())
    targets = _targets(NUM, 2, size=0.05)
    theirs, ours = (_advance(env, targets) for env in (batch, robots))
    torch.testing.assert_close(ours["truth", "qpos"], theirs["truth", "qpos"], rtol=0, atol=2e-3)
    for name in ("body_invweight0", "dof_invweight0"):
        expected = np.array([_derived(batch, i, name) for i in range(NUM)])
        got = getattr(robots.simulations.m, name).numpy().reshape(expected.shape)
        np.testing.assert_allclose(got, expected, rtol=2e-3, atol=1e-7)


def _derived(batch: BatchEnv, index: int, name: str) -> np.ndarray:
    part = batch.simulations.parts[0]
    return np.array(part.batch.expand(name)[index])


def test_pushes_accelerate_and_end(robots: WarpEnv) -> None:
    batch = BatchEnv(NUM, num_threads=1)
    push = torch.tensor([[100.0, 0, 0], [0, 0, 0], [0, 80.0, 0], [0, 0, 50.0]])
    results = []
    for env in (batch, robots):
        env.reset()
        _step(env, STANDING.expand(NUM, 10), push=push)
        results.append(_step(env, STANDING.expand(NUM, 10))["truth", "pelvis_velocity"])
    torch.testing.assert_close(*results, rtol=0, atol=2e-3)
    with pytest.raises(ShapeError, match="push"):
        _step(robots, STANDING.expand(NUM, 10), push=push[:, :2])


def test_a_watched_robot_shows_its_substeps(robots: WarpEnv) -> None:
    robots.reset()
    robots.watch(2)
    after = _advance(robots, _targets(NUM, 2))
    watched = robots.watched
    np.testing.assert_allclose(watched[-1, :35], after["truth", "qpos"][2], atol=1e-6)
    assert (np.diff(watched[:, 2]) != 0).all()
    with pytest.raises(ConfigurationError, match="simulation must be from 0 to 3, got 9"):
        robots.watch(9)


def test_overflow_ends_an_episode_and_is_an_error_beyond_a_share() -> None:
    """A robot that stands has more contacts than fit."""
    env = WarpEnv(2, device="cpu", contacts=2, constraints=60)
    env.reset()
    ended = torch.zeros(2, 1, dtype=torch.bool)
    with pytest.raises(ConfigurationError, match=r"raise contacts \(now 2\)"):
        for _ in range(200):
            ended |= _step(env, STANDING.expand(2, 10))["terminated"]
    assert ended.all() and env.overflows > 0


def test_stones_differ_and_long_delays_lengthen_the_memory_of_states(robots: WarpEnv) -> None:
    """Robots on stones are those of the batch; a polygon needs another model."""
    size = robots.states().shape[1]
    env, batch = WarpEnv(2, device="cpu"), BatchEnv(2, num_threads=1)
    row, corners = [0.0] * 6, [[-0.5, -0.6], [0.4, -0.7], [0.4, 0.6], [-0.5, 0.6]]
    polygon = Course(np.array([row, [0.7, 0.1, 0.05, 0.3, 0.3, 0.3]]), {0: np.array(corners)})
    request = TensorDict(course=TensorDict(stones=torch.full((2, 2, 6), torch.nan)), batch_size=2)
    request["course", "stones"][1] = torch.tensor(pattern("up", count=2).stones[:2])
    falls = []
    for each in (batch, env):
        each.set_course(polygon)
        # the first robot keeps its polygon, the second falls between two stones
        mask = torch.tensor([[False], [True]])
        each.reset(request.clone().set("_reset", mask))
        qpos = _QPOS.repeat(2, 1)
        qpos[1, :3] += torch.tensor([0.9, 0.5, 0.0])
        initial = TensorDict(qpos=qpos, qvel=torch.zeros(2, 32), batch_size=2)
        each.reset(TensorDict(initial=initial, batch_size=2))
        falls.append(_advance(each, STANDING.expand(12, 2, -1))["truth", "pelvis_position"])
    torch.testing.assert_close(*falls, rtol=0, atol=2e-3)
    assert falls[0][1, 2] < falls[0][0, 2] - 0.1
    env.set_course(None)
    env.set_dynamics({"torque_delay": 0.02})
    _advance(env, _targets(2, 3))
    states = env.states()
    assert states.shape[1] > size
    after = _advance(env, _targets(2, 1, seed=1))
    env.set_states(states)
    torch.testing.assert_close(
        _advance(env, _targets(2, 1, seed=1))["truth", "qpos"], after["truth", "qpos"],
        rtol=0, atol=1e-6,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ("cuda", "no GPU for device 'cuda'"),
        ("mps", "device must be 'cuda' or 'cpu', got 'mps'"),
        ("gpu", "device must be 'cuda' or 'cpu', got 'gpu'"),
    ],
)
def test_a_device_that_cannot_simulate_is_refused(
    device: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigurationError, match=message):
        aslip.make_env("warp", device=device)


def test_an_old_driver_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(warp, "get_cuda_driver_version", lambda: (12, 2))
    with pytest.raises(ConfigurationError, match=r"knows CUDA 12\.2; physics needs one of 12\.4"):
        check_device("cuda")


def test_a_gpu_beyond_the_last_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(warp, "get_cuda_driver_version", lambda: (13, 0))
    assert check_device("cuda") == torch.device("cuda:0")
    with pytest.raises(ConfigurationError, match="no GPU 'cuda:1': there are 1"):
        check_device("cuda:1")


def test_an_estimator_of_arrays_moves_to_no_device() -> None:
    transform = EstimatedState(Own())
    with pytest.raises(ConfigurationError, match="Own takes arrays of NumPy"):
        transform.move(torch.device("cpu"))


def test_too_little_memory_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'")

    monkeypatch.setattr("mujoco_warp.make_data", fail)
    with pytest.raises(ConfigurationError, match=r"too little memory for 3 robots .*: take fewer"):
        WarpEnv(3, device="cpu")


def test_the_estimator_of_a_device_walks() -> None:
    """Estimators of arrays and of tensors give the same rewards; one of a user's own is used."""
    policy = aslip.load_policy("straight")
    rewards = []
    for estimator in (None, Own(), DeviceEstimator("cpu")):
        env = aslip.make_env(num_envs=2, seed=0, replace={"estimator": EstimatedState(estimator)})
        with torch.no_grad():
            rewards.append(env.rollout(10, policy)["next", "reward"])
    torch.testing.assert_close(rewards[1], rewards[0], rtol=0, atol=0)
    torch.testing.assert_close(rewards[2], rewards[0], rtol=0, atol=1e-6)
