"""Command and clock: drawn at resets, held or advanced at steps, settable by callers."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from aslip.envs import StackEnv
from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms import SpeedCommand, VelocityCommand
from aslip.transforms.command import approach_command
from tests.helpers import MakeEnv, leaves, seeded
from tests.library.bent import Bent, symmetric_library


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


def test_commands_change_at_random_times(library: GaitLibrary) -> None:
    """Changes have the mean interval, reach every speed and are independent across robots."""
    transform = seeded(SpeedCommand(library, [0.5, 1.0, 1.5], 10 * CASSIE.policy_period))
    commands = [torch.full((200, 1), 0.5)]
    for _ in range(60):
        td = TensorDict(command=commands[-1], batch_size=200)
        commands.append(transform._step(td, TensorDict(batch_size=200))["command"])
    changes = torch.cat(commands, dim=-1).diff(dim=-1) != 0
    assert set(commands[-1].flatten().tolist()) == {0.5, 1.0, 1.5}
    # one in three draws repeats the old speed
    assert float(changes.float().mean()) == pytest.approx(0.1 * 2 / 3, abs=0.01)
    assert changes.sum(-1).unique().numel() > 5


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


PERIOD = 0.03


@pytest.fixture(scope="module")
def cut(library: GaitLibrary) -> GaitLibrary:
    """Library over an octahedron of commands with the zero command in its middle."""
    gait = library.gaits[0]

    class Still(Bent):
        def __init__(self, x: float, y: float, w: float) -> None:
            super().__init__(gait, y, w)
            self.command[0] = x

    motions = [
        Still(x, y, w)
        for x in (-0.2, 0.0, 0.2)
        for y in (-0.2, 0.0, 0.2)
        for w in (-1.0, 0.0, 1.0)
        if abs(x) / 0.2 + abs(y) / 0.2 + abs(w) <= 1
    ]
    with pytest.warns(UserWarning, match=r"body\.velocity is not the rate"):
        return GaitLibrary.from_motions(motions, samples=8, missing=True)


def test_commands_fill_a_region_that_is_no_box(cut: GaitLibrary) -> None:
    command = seeded(VelocityCommand(cut, straight=0, turning=0, in_place=0)).draw((2000, 3))
    gauge = command[:, 0].abs() / 0.2 + command[:, 1].abs() / 0.2 + command[:, 2].abs()
    assert gauge.max() <= 1 + 1e-5
    # uniform in an octahedron: the share within half its size is an eighth
    assert float((gauge < 0.5).float().mean()) == pytest.approx(1 / 8, abs=0.03)
    assert cut.covers(command).all()


def test_shares_of_special_commands(cut: GaitLibrary) -> None:
    command = seeded(VelocityCommand(cut, straight=0.3, turning=0.2, in_place=0.1)).draw((4000, 3))
    zero = command == 0
    kinds = {
        "straight": (zero[:, 1] & zero[:, 2] & ~zero[:, 0], 0.3),
        "turning": (zero[:, 0] & zero[:, 1] & ~zero[:, 2], 0.2),
        "in place": (zero.all(-1), 0.1),
        "any": (~zero.any(-1), 0.4),
    }
    for name, (rows, share) in kinds.items():
        assert float(rows.float().mean()) == pytest.approx(share, abs=0.03), name


def test_draws_follow_the_seed_and_shares_are_checked(cut: GaitLibrary) -> None:
    first, second = seeded(VelocityCommand(cut)), seeded(VelocityCommand(cut))
    assert torch.equal(first.draw((20, 3)), second.draw((20, 3)))
    second.set_seed(1)
    assert not torch.equal(first.draw((20, 3)), second.draw((20, 3)))
    with pytest.raises(ConfigurationError, match="add up to at most 1"):
        VelocityCommand(cut, straight=0.8, turning=0.3)
    with pytest.raises(ConfigurationError, match="turning must be"):
        VelocityCommand(cut, turning=-0.1)


def test_special_commands_need_the_zero_command(library: GaitLibrary) -> None:
    motions = [Bent(library.gaits[i], y, 0.1) for i in (4, 8) for y in (-0.2, 0.2)]
    away = GaitLibrary.from_motions(motions, samples=8)
    with pytest.raises(SpeedOutOfRangeError, match="0, 0, 0"):
        VelocityCommand(away)
    command = seeded(VelocityCommand(away, straight=0, turning=0, in_place=0)).draw((9, 3))
    assert away.covers(command).all()


def test_commands_outside_the_region_are_those_of_the_nearest_inside(cut: GaitLibrary) -> None:
    command = torch.tensor([[0.1, 0.05, 0.2], [0.2, 0.2, 0.0], [0.3, 0.0, 0.0]])
    assert cut.covers(command).tolist() == [[True], [False], [False]]
    nearest = cut.nearest(command)
    assert torch.equal(nearest[0], command[0])
    torch.testing.assert_close(nearest[1:], torch.tensor([[0.1, 0.1, 0.0], [0.2, 0.0, 0.0]]))
    with pytest.raises(ShapeError, match=r"\(\.\.\., 3\)"):
        cut.covers(torch.zeros(2, 1))


def test_speeds_alone_are_no_commands_of_several_axes() -> None:
    with pytest.raises(ConfigurationError, match="3 numbers; use VelocityCommand"):
        SpeedCommand(symmetric_library())


# ------------------------------------------------------------------------ the filter


def test_a_filtered_command_goes_straight_to_the_command_at_the_largest_rate() -> None:
    past, command = torch.zeros(1, 3), torch.tensor([[0.6, 0.2, -1.2]])
    rates, path = (2.0, 1.5, 2.0), [past]
    while not torch.equal(path[-1], command):
        path.append(approach_command(path[-1], command, rates))
    # the yaw rate takes longest: 1.2 rad/s at 2 rad/s^2
    assert len(path) - 1 == pytest.approx(0.6 / PERIOD, abs=1)
    change = torch.cat(path).diff(dim=0).abs()
    assert (change <= PERIOD * torch.tensor(rates) * (1 + 1e-5)).all()
    shares = torch.cat(path[1:-1]) / command
    torch.testing.assert_close(shares, shares[:, :1].expand_as(shares))


def test_a_small_change_is_made_at_once() -> None:
    past, command = torch.zeros(2, 1), torch.tensor([[0.06], [0.07]])
    found = approach_command(past, command, (2.0,))
    torch.testing.assert_close(found, torch.tensor([[0.06], [0.06]]))
