"""Command and clock: drawn at resets, held or advanced at steps, settable by callers."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from aslip.envs import StackEnv
from aslip.errors import ConfigurationError, SpeedOutOfRangeError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms import SpeedCommand
from tests.helpers import MakeEnv, leaves


def _start(command: float, phase: float, num: int = 1) -> TensorDict:
    return TensorDict(
        command=torch.full((num, 1), command), phase=torch.full((num, 1), phase), batch_size=num
    )


def _still(td: TensorDictBase) -> TensorDictBase:
    return td.set("action", torch.zeros(*td.batch_size, 10))


def _end_some(td: TensorDictBase, rows: list[int]) -> TensorDictBase:
    """Tensordict in which some episodes have just ended."""
    td = td.clone()
    for key in ("done", "terminated"):
        td[key][rows] = True
    return td


def _walk(env: StackEnv, td: TensorDictBase, steps: int) -> TensorDictBase:
    for _ in range(steps):
        td = env.step(_still(td))["next"]
    return td


# ---------------------------------------------------------------- drawing


def test_commands_are_speeds_of_the_library(make: MakeEnv, library: GaitLibrary) -> None:
    """All 21 speeds are drawn about equally often."""
    command = make(num_envs=420).reset()["command"]
    values, counts = command.unique(return_counts=True)
    torch.testing.assert_close(values, torch.tensor(library.speeds.copy()).float())
    assert counts.min() >= 5
    assert counts.max() <= 45


def test_commands_change_at_random_times(make: MakeEnv, library: GaitLibrary) -> None:
    """Changes have the mean interval, reach every speed and are independent across robots."""
    interval = 10 * CASSIE.policy_period
    command = SpeedCommand(library, [0.5, 1.0, 1.5], interval)
    env = make(num_envs=50, replace={"command": command}, drop=["fall", "low_reward"])
    walk = env.rollout(30, break_when_any_done=False)
    before, after = walk["command"][..., 0], walk["next", "command"][..., 0]
    assert set(after.unique().tolist()) == {0.5, 1.0, 1.5}
    # one in three draws repeats the old speed
    share = float((before != after).float().mean())
    assert share == pytest.approx(0.1 * 2 / 3, abs=0.02)
    held = (before == after).float().mean(1)
    assert held.unique().numel() > 5


def test_changes_of_the_command_follow_the_seed(make: MakeEnv, library: GaitLibrary) -> None:
    walks = []
    for seed in (3, 3, 4):
        command = SpeedCommand(library, interval=0.3)
        env = make(num_envs=4, seed=seed, replace={"command": command})
        td = TensorDict(command=torch.ones(4, 1), batch_size=4)
        walks.append(_walk(env, env.reset(td), 20)["command"])
    assert torch.equal(walks[0], walks[1])
    assert not torch.equal(walks[0], walks[2])


def test_speeds_outside_the_library_are_refused(library: GaitLibrary) -> None:
    with pytest.raises(SpeedOutOfRangeError, match=r"2\.1 m/s is outside.*0 to 2 m/s"):
        SpeedCommand(library, speeds=[1.0, 2.1])


# --------------------------------------------------------------- the clock


@pytest.mark.parametrize("speed", [0.0, 0.73, 2.0])
def test_the_clock_advances_by_time_and_wraps(
    make: MakeEnv, library: GaitLibrary, speed: float
) -> None:
    """A step advances the stride by 0.03 s at any speed."""
    env = make()
    td = env.reset(_start(speed, 0.95))
    stride = library.stride(torch.tensor([[speed]]))
    phases = [td["phase"].item()]
    for _ in range(4):
        td = env.step(_still(td))["next"]
        phases.append(td["phase"].item())
    expected = [(0.95 + k * CASSIE.policy_period / stride.item()) % 1 for k in range(5)]
    assert phases == pytest.approx(expected, abs=1e-6)
    assert min(phases) < 0.2  # the phase has wrapped
    assert env.reset(_start(speed, 1.25))["phase"].item() == pytest.approx(0.25)


def test_a_caller_can_set_phase_and_command(make: MakeEnv) -> None:
    env = make(num_envs=3)
    start = TensorDict(
        command=torch.tensor([[0.1], [0.85], [2.0]]),
        phase=torch.tensor([[0.0], [0.5], [0.999]]),
        batch_size=3,
    )
    td = env.reset(start.clone())
    for key in ("command", "phase"):
        torch.testing.assert_close(td[key], start[key], rtol=0, atol=0)
    only_command = env.reset(start.select("command"))
    torch.testing.assert_close(only_command["command"], start["command"])
    assert not torch.equal(only_command["phase"], start["phase"])


def test_a_change_of_command_keeps_the_phase(make: MakeEnv, library: GaitLibrary) -> None:
    """The new speed acts on the next policy step: its stride, then its reference."""
    env = make()
    td = _walk(env, env.reset(_start(0.5, 0.1)), 2)
    phase = td["phase"].clone()
    td["command"] = torch.full((1, 1), 1.5)
    after = env.step(_still(td))["next"]
    assert after["command"].item() == 1.5
    advance = CASSIE.policy_period / library.stride(torch.tensor([[1.5]]))
    torch.testing.assert_close(after["phase"], phase + advance.float())
    expected = library.lookup(after["phase"], after["command"])
    torch.testing.assert_close(after["reference", "body_velocity"], expected.body_velocity)
    assert _walk(env, after, 2)["command"].item() == 1.5


# ---------------------------------------------------------- partial resets


@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_a_partial_reset_leaves_the_other_rows_alone(make: MakeEnv, backend: str) -> None:
    """Command, phase, reference, estimate, true state and counters stay as they were."""
    env = make(backend, num_envs=4, drop=["low_reward"])
    td = env.reset(_start(0.8, 0.3, 4))
    for k in range(3):
        td = env.step(td.set("action", torch.full((4, 10), 0.01 * (k + 1))))["next"]
    ended = _end_some(td, [1, 3])
    reset = env.maybe_reset(ended.clone())
    kept, new = torch.tensor([0, 2]), torch.tensor([1, 3])
    zeroed = {("step_count",), ("last_action",), ("episode_reward",)}
    for key, value in leaves(reset).items():
        if key in leaves(td) and key[0] not in ("reward", "reward_terms"):
            torch.testing.assert_close(value[kept], td[key][kept], rtol=0, atol=0, msg=str(key))
        if key in zeroed:
            assert (value[new] == 0).all(), key
            assert (value[kept] != 0).all(), key
    for key in (
        "command",
        "phase",
        ("truth", "qpos"),
        "observation",
        ("reference", "body_position"),
    ):
        assert (reset[key][new] != td[key][new]).any(dim=-1).all(), key
    assert not reset["done"].any()
    # the simulator's state equals the reported one
    following = env.step(_still(reset.clone()))["next"]
    unbroken = make(backend, num_envs=4, drop=["low_reward"])
    other = unbroken.reset(_start(0.8, 0.3, 4))
    for k in range(3):
        other = unbroken.step(other.set("action", torch.full((4, 10), 0.01 * (k + 1))))["next"]
    other = unbroken.step(_still(other))["next"]
    torch.testing.assert_close(
        following["truth", "qpos"][kept], other["truth", "qpos"][kept], rtol=0, atol=0
    )


def test_the_initial_state_is_not_left_in_the_tensordict(make: MakeEnv) -> None:
    """The initial state is a request to the backend, not an entry of the episode."""
    request = _start(0.7, 0.2)
    for td in (make().reset(request), make().reset(), request):
        assert "initial" not in set(td.keys())


def test_a_reset_mask_draws_new_values_for_its_rows(make: MakeEnv) -> None:
    """TorchRL passes the old tensordict with a mask, so its values are stale."""
    env = make(num_envs=2)
    td = env.reset(_start(0.55, 0.1, 2))
    td["_reset"] = torch.tensor([[False], [True]])
    after = env.reset(td.clone())
    for key in ("command", "phase"):
        assert after[key][0] == td[key][0]
        # no gait of the library has this speed
        assert after[key][1] != td[key][1]


@pytest.mark.parametrize("key", ["command", "phase"])
def test_a_command_that_is_not_finite_is_refused(make: MakeEnv, key: str) -> None:
    env = make(num_envs=2)
    start = _start(0.5, 0.1, 2)
    start[key] = torch.tensor([[0.5], [torch.nan]])
    with pytest.raises(ConfigurationError, match=f"{key} must be finite"):
        env.reset(start)
    td = env.reset().set("action", torch.zeros(2, 10))
    td[key][1] = torch.nan
    with pytest.raises(ConfigurationError, match=f"{key} must be finite"):
        env.step(td)


@pytest.mark.parametrize("speed", [-0.01, 2.01])
def test_a_command_outside_the_library_is_refused(make: MakeEnv, speed: float) -> None:
    env = make(num_envs=2)
    with pytest.raises(SpeedOutOfRangeError, match=f"{speed:g} m/s.*0 to 2 m/s"):
        env.reset(_start(speed, 0.0, 2))
    td = env.reset(_start(2.0, 0.0, 2))
    td["command"][1] = speed
    with pytest.raises(SpeedOutOfRangeError, match="0 to 2 m/s"):
        env.step(td.set("action", torch.zeros(2, 10)))


def test_a_keyword_of_reset_is_not_ignored(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match=r"no keyword command.*TensorDict\(command"):
        make().reset(command=1.0)
