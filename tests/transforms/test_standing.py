"""Standing on command: clock, filter, and the reference through stop, standing and start."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import aslip
from aslip.control.steering import Steering
from aslip.envs import EPISODE_ENDS, StackEnv, directions_stack
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary, TransitionTable, WalkMode
from aslip.library.transitions import HALF
from aslip.robot import CASSIE
from aslip.transforms import COMMAND_RATES, StandClock, StandCommand, StandFilter, advance_mode
from aslip.transforms.balance import Balance
from aslip.transforms.standing import STOP_RATES, stop_rates
from tests.helpers import seeded
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library

PERIOD = CASSIE.policy_period


def _run(
    library: GaitLibrary,
    phase: float,
    stand_commands: list[tuple[float, float]],
    period: float = PERIOD,
    mode: int = WalkMode.WALK,
    command: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Phases and modes (k,) over time, under stand commands (stand, duration [s])."""
    at = torch.tensor([[phase]], dtype=torch.float64), torch.tensor([[float(mode)]])
    steer, seen = torch.tensor([[command, 0.0, 0.0]]), [at]
    for stand, duration in stand_commands:
        for _ in range(round(duration / period)):
            at = advance_mode(library, *at, steer, torch.tensor([[stand]]), period)
            seen.append(at)
    phases, modes = (torch.cat(part)[:, 0] for part in zip(*seen, strict=True))
    return phases, modes


@pytest.mark.parametrize("phase", [0.1, 0.6, 0.38], ids=["left swing", "right swing", "landed"])
def test_robot_stops_at_the_next_touchdown_and_stands(
    walking: GaitLibrary, table: TransitionTable, phase: float
) -> None:
    """Counted from the touchdown, a stop takes its time."""
    period = 5e-3
    phases, modes = _run(walking, phase, [(1.0, 1.2)], period)
    stride = float(walking.stride(torch.zeros(1, 3)))
    landing = table.touchdown if phase < table.touchdown else 0.5 + table.touchdown
    begins = (landing - phase) * stride / period
    stops = torch.nonzero(modes == WalkMode.STOP).flatten()
    stands = torch.nonzero(modes == WalkMode.STAND).flatten()
    assert stops[0].item() == pytest.approx(begins, abs=1.01)
    ends = begins + table.durations[0] / period
    assert stands[0].item() == pytest.approx(ends, abs=1.01)
    assert torch.equal(stands, torch.arange(int(stands[0]), len(modes)))
    expected = table.standing + (landing > 0.5) * 0.5
    assert phases[-1].item() == pytest.approx(expected, abs=1e-9)
    # the clock never jumps, nor runs back
    steps = (phases.diff() + 0.5) % 1.0 - 0.5
    assert steps.min() >= -1e-9
    assert steps.max() <= 1.01 * period / stride


def test_start_leads_to_the_lift_off_of_the_other_foot(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    period = 5e-3
    count = int(table.durations[1] / period)
    phases, modes = _run(walking, table.standing, [(0.0, 0.6)], period, WalkMode.STAND)
    assert (modes[1 : count + 1] == WalkMode.START).all()
    assert (modes[count + 2 :] == WalkMode.WALK).all()
    stride = float(walking.stride(torch.zeros(1, 3)))
    walked = 0.6 - table.durations[1]
    assert phases[-1].item() == pytest.approx(0.5 + walked / stride, abs=1e-9)


def test_changes_within_a_step_are_exact(walking: GaitLibrary) -> None:
    """Long steps end where short ones do."""
    stand_commands = [(1.0, 1.2), (0.0, 0.6)]
    coarse, fine = (_run(walking, 0.2, stand_commands, period) for period in (0.03, 0.01))
    torch.testing.assert_close(fine[0][::3], coarse[0], rtol=0, atol=1e-9)
    assert torch.equal(fine[1][::3], coarse[1])
    assert set(coarse[1].tolist()) == {0.0, 1.0, 2.0, 3.0}


def test_stop_that_has_begun_is_finished(walking: GaitLibrary) -> None:
    _, modes = _run(walking, 0.35, [(1.0, 0.09), (0.0, 1.5)])
    changes = modes[torch.cat([torch.tensor([True]), modes.diff() != 0])]
    assert changes.tolist() == [0.0, 1.0, 2.0, 3.0, 0.0]


def test_stop_waits_until_the_robot_is_steady(walking: GaitLibrary, table: TransitionTable) -> None:
    """At the first touchdown it is not, at the second it is."""
    at = torch.tensor([[0.2]]), torch.zeros(1, 1)
    rest, stand = torch.zeros(1, 3), torch.ones(1, 1)
    modes, phases = [], []
    for _ in range(60):
        steady = torch.tensor([[at[0].item() > HALF]])
        balance = Balance(steady, torch.zeros(1, 1, dtype=torch.bool))
        at = advance_mode(walking, *at, rest, stand, balance=balance)
        phases.append(at[0].item())
        modes.append(at[1].item())
    first = modes.index(WalkMode.STOP)
    assert phases[first] > HALF + table.touchdown
    assert modes[-1] == WalkMode.STAND


@pytest.mark.parametrize(("leans_left", "lift_off"), [(True, 0.5), (False, 0.0)])
def test_robot_that_tips_lifts_the_foot_that_it_does_not_lean_to(
    walking: GaitLibrary, table: TransitionTable, leans_left: bool, lift_off: float
) -> None:
    """At once, whatever foot would leave next in a start."""
    rest, stand_commands = torch.zeros(1, 3), torch.ones(1, 1)
    balance = Balance(torch.tensor([[False]]), torch.tensor([[leans_left]]))
    stride = float(walking.stride(rest))
    for half in (0.0, 0.5):
        standing = torch.tensor([[half + table.standing]]), torch.tensor([[2.0]])
        phase, mode = advance_mode(walking, *standing, rest, stand_commands, balance=balance)
        assert mode.item() == WalkMode.WALK
        assert phase.item() == pytest.approx(lift_off + PERIOD / stride, abs=1e-6)


@pytest.mark.parametrize(("stand", "command"), [(0.0, 0.0), (1.0, 0.1)])
def test_robot_walks_on_unless_it_shall_stand_and_steps_in_place(
    walking: GaitLibrary, stand: float, command: float
) -> None:
    phases, modes = _run(walking, 0.2, [(stand, 1.5)], command=command)
    assert not modes.any()
    stride = walking.stride(torch.tensor([[command, 0.0, 0.0]]))
    assert phases[-1].item() == pytest.approx((0.2 + 1.5 / float(stride)) % 1, abs=1e-6)


def test_single_precision_keeps_the_half_of_the_stride(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    """At the end of a start, where a rounded phase would be on the other side of the lift-off."""
    for half in (0.0, 0.5):
        phase = torch.tensor([[half + 0.5 - table.rates[1] * PERIOD]], dtype=torch.float32)
        mode, rest = torch.tensor([[float(WalkMode.START)]]), torch.zeros(1, 3)
        for shift in (-3e-8, 0.0, 3e-8):
            found, after = advance_mode(walking, phase + shift, mode, rest, torch.ones(1, 1))
            assert after.item() == WalkMode.WALK
            assert (found.item() - half - 0.5) % 1.0 == pytest.approx(0.0, abs=1e-6)


# ------------------------------------------------------------------ in an environment


@pytest.fixture(scope="module")
def env() -> StackEnv:
    stack = directions_stack(standing_library())
    drop = (*EPISODE_ENDS, "noise", "fall", "estimator", "observation", "path_diff", "heading_diff")
    return aslip.make_env(stack=stack, num_envs=2, num_threads=1, drop=drop, seed=0)


def _start(env: StackEnv, command: list[list[float]], **entries: list[float]) -> TensorDictBase:
    columns = {name: torch.tensor(values)[:, None] for name, values in entries.items()}
    request = {"command": torch.tensor(command), **columns}
    return env.reset(TensorDict(request, batch_size=env.num_envs))  # pyright: ignore


def _step(env: StackEnv, td: TensorDictBase) -> TensorDictBase:
    td["action"] = torch.zeros(env.num_envs, 10)
    return env.step(td)["next"]


def test_reference_leads_from_a_walk_to_standing_and_back(env: StackEnv) -> None:
    """Without jumps; the target of a step is the next reference, bit for bit."""
    td = _start(env, [[0.1, 0.0, 0.1], [0.0, 0.0, 0.0]], phase=[0.1, 0.65], stand=[0.0, 0.0])
    modes = []
    for count in range(44):
        td["stand"] = torch.full((2, 1), float(1 <= count < 25))
        past = td
        td = _step(env, td)
        modes.append(td["mode"][:, 0].tolist())
        steer = td["filtered_command"]
        for name in ("body_position", "left_foot_position", "right_foot_position"):
            target, now = past["target", name], td["reference", name]
            torch.testing.assert_close(now, target, rtol=0, atol=0.02)
            # a change of the stand command or of the command is not foreseen
            if count not in (1, 25) and torch.equal(past["filtered_command"], steer):
                assert torch.equal(now, target)
        if count == 24:
            assert not td["filtered_command"].any()
            assert (td["mode"] == WalkMode.STAND).all()
            assert td["reference", "motor_velocity"].abs().max() < 1e-6
    assert torch.equal(td["filtered_command"], td["command"])
    for robot in range(2):
        passed = [one[robot] for one in modes]
        assert list(dict.fromkeys(passed)) == [0.0, 1.0, 2.0, 3.0]
        assert passed[-1] == WalkMode.WALK


def test_stops_are_faster_than_changes_of_the_command(env: StackEnv) -> None:
    """The first robot shall stand, the second one walk in place."""
    td = _start(env, [[0.2, 0.0, 0.0]] * 2, phase=[0.1, 0.1], stand=[0.0, 0.0])
    td["stand"], td["command"][1] = torch.tensor([[1.0], [0.0]]), 0.0
    forward = _step(env, td)["filtered_command"][:, 0]
    expected = [0.2 - PERIOD * rate for rate in (STOP_RATES[0], COMMAND_RATES[0])]
    torch.testing.assert_close(forward, torch.tensor(expected), rtol=0, atol=1e-6)
    assert STOP_RATES[0] > COMMAND_RATES[0]


@pytest.mark.parametrize(
    ("stand", "mode"), [(1.0, WalkMode.WALK), (0.0, WalkMode.STOP), (0.0, WalkMode.START)]
)
def test_rates_that_are_faster_than_those_of_stops_stay(stand: float, mode: WalkMode) -> None:
    """Until the robot walks again."""
    commands, modes = torch.tensor([[stand], [0.0]]), torch.tensor([[mode], [WalkMode.WALK]])
    rates = stop_rates((2.0, 0.5, 1.0), commands, modes)
    assert rates.tolist() == [[2.0, STOP_RATES[1], 1.0], [2.0, 0.5, 1.0]]


@pytest.mark.parametrize("rates", [(1.0, 1.0), (1.0, 1.0, 1.0, 1.0)])
def test_robots_that_stand_need_a_rate_for_each_part_of_the_command(
    walking: GaitLibrary, rates: tuple[float, ...]
) -> None:
    with pytest.raises(ConfigurationError, match=f"need 3 rates of the command, got {len(rates)}"):
        StandFilter(rates)
    with pytest.raises(ConfigurationError, match=f"need 3 rates of the command, got {len(rates)}"):
        Steering(walking, rates, True, 1.0)


def test_robot_that_shall_stand_at_a_reset_starts_standing(
    env: StackEnv, table: TransitionTable
) -> None:
    td = _start(env, [[0.5, 0.0, 0.0]] * 2, phase=[0.1, 0.9], stand=[1.0, 0.0])
    assert td["mode"][:, 0].tolist() == [WalkMode.STAND, WalkMode.WALK]
    assert td["phase"][:, 0].tolist() == pytest.approx([table.standing, 0.9])
    assert not td["filtered_command"][0].any()
    assert torch.equal(td["filtered_command"][1], td["command"][1])
    height = td["truth", "pelvis_position"][0, 2].item()
    assert height == pytest.approx(table.body_position[0, 0, -1, 2], abs=1e-5)
    assert td["truth", "pelvis_velocity"][0].abs().max() < 1e-6


def test_stand_commands_change_at_their_rate() -> None:
    command, robots, steps = seeded(StandCommand(share=1 / 3, interval=0.3)), 4000, 50
    td = TensorDict(stand=torch.zeros(robots, 1), batch_size=robots)
    seen = [td["stand"]]
    for _ in range(steps):
        td = command._step(td, TensorDict(batch_size=robots))
        seen.append(td["stand"])
    commands = torch.cat(seen, dim=-1)
    assert commands[:, -1].mean().item() == pytest.approx(1 / 3, abs=0.03)
    changes = commands.diff(dim=-1)[:, steps // 2 :].abs().mean().item()
    # one draw in ten steps, of which 4/9 differ from the one before
    assert changes == pytest.approx(0.1 * 4 / 9, rel=0.1)
    # at an interval without end, none changes
    kept = seeded(StandCommand(share=1 / 3))._step(td, TensorDict(batch_size=robots))["stand"]
    assert torch.equal(kept, td["stand"])


def test_library_without_stop_and_start_has_no_clock_for_them() -> None:
    with pytest.raises(ConfigurationError, match="standing needs a library with stop and start"):
        StandClock(symmetric_library())
