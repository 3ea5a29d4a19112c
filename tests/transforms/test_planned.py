"""References of a planner: motion without jumps, feet at their places, stones, random footsteps."""

from dataclasses import replace
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Unbounded

import aslip
from aslip.envs import ON_TRUTH, Stack, StackEnv, insert_before
from aslip.envs.directions import planned_stack
from aslip.envs.straight import shipped_library
from aslip.ik import LegTable
from aslip.planning import BatchPlanner, Planner, WalkState
from aslip.policy import check_policy_fits, load_policy
from aslip.robot import CASSIE, SIDES
from aslip.transforms import (
    DIRECTION_TABLE,
    AssembleObservation,
    PlannedReference,
    RandomFootsteps,
    SeededTransform,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.observation import join_entries, planned_table
from aslip.transforms.plan_motors import _YIELD, NEAR, PlanMotors, _feet, _turned
from aslip.transforms.planned import default_planner
from aslip.transforms.rotation import rotate_about_vertical

NUM = 6


def _walk(env: StackEnv, steps: int = 40, **first: torch.Tensor) -> Any:
    """Entries (NUM, steps) of walks of a policy."""
    start = TensorDict({"command": torch.tensor([[0.5, 0.0, 0.3]] * NUM), **first}, [NUM])
    policy, found = load_policy("stones"), []
    td = env.reset(start)
    for _ in range(steps):
        found.append(td)
        td["command"] = start["command"]
        td = env.step_mdp(env.step(policy(td)))
    return torch.stack(found, 1)


def _planned(*sizes: float, **settings: Any) -> Stack:
    """Stack whose robots follow plans on the floor."""
    footsteps = RandomFootsteps(*sizes, **settings)
    return insert_before(planned_stack(), "reference", footsteps=footsteps)


@pytest.fixture(scope="module")
def walk() -> Any:
    stack = _planned(share=1.0, interval=0.2)
    env = aslip.make_env(num_envs=NUM, seed=3, stack=stack, drop=["low_reward"])
    heading = torch.linspace(2.8, 3.4, NUM)[:, None]
    return _walk(env, heading=heading, stand=torch.zeros(NUM, 1))


def test_plans_go_on_where_they_led(walk: Any) -> None:
    """Swing feet stay on their path while footholds change, also where the heading wraps."""
    target: Any = walk["target"][:, :-1]
    reference: Any = walk["reference"][:, 1:]
    led = WalkState.from_rows(walk["plan", "state"][:, :-1].flatten(0, 1))
    swing = (led.stance[:, None] != torch.arange(2)).reshape(NUM, -1, 2)
    swing &= ~walk["estimator", "contact"][:, 1:]  # feet that touch the ground may have landed
    for i, side in enumerate(SIDES):
        moves = (reference[f"{side}_foot_velocity"] - target[f"{side}_foot_velocity"])[
            swing[..., i]
        ]
        turns = (reference[f"{side}_foot_heading"] - target[f"{side}_foot_heading"])[swing[..., i]]
        assert moves.abs().max() < 1e-4
        assert turns.abs().max() < 1e-4
    assert swing.sum() > NUM * 10
    shift, stance = walk["footsteps", "shift"], led.stance.reshape(NUM, -1)
    in_flight = stance[:, 1:] == stance[:, :-1]
    jumps = (walk["plan", "foothold"][:, 2:] - walk["plan", "foothold"][:, 1:-1]).norm(dim=-1)
    assert jumps[in_flight & (shift[:, 2:] != shift[:, 1:-1]).any(-1)].max() > 0.1
    assert walk["heading"].amin() < -3
    assert walk["heading"].amax() > 3


def test_each_step_has_a_displacement_of_its_own(walk: Any) -> None:
    """Also after feet that touch the ground before their time."""
    stance = WalkState.from_rows(walk["plan", "state"].flatten(0, 1)).stance.reshape(NUM, -1)
    drawn = (walk["footsteps", "shift"].diff(dim=1) != 0).any(-1)
    lands = stance.diff(dim=1)[:, :-1] != 0
    assert lands.sum() > 2 * NUM
    # in the step of the touchdown, or in the next one
    assert (drawn[:, :-1] | drawn[:, 1:])[lands].all()


def test_plans_keep_where_the_foot_in_stance_was_to_land(walk: Any) -> None:
    """The foothold is that of the last plan before the touchdown, also as the frame moves on."""
    yaw = walk["heading"]
    aim, last = (
        walk["odometry", "origin"] + rotate_about_vertical(walk["plan", key], yaw)
        for key in ("foothold", "last_foothold")
    )
    stays = (last[:, 1:] - last[:, :-1])[..., :2].norm(dim=-1) < 1e-5
    lands = (last[:, 1:] - aim[:, :-1])[..., :2].norm(dim=-1) < 1e-5
    assert (stays ^ lands).all()
    assert lands.sum(1).min() >= 2


def test_motors_put_feet_where_the_target_says(walk: Any) -> None:
    """Those that bear no weight are as much higher as the pelvis sinks below the plan."""
    target: Any = walk["target"].flatten(0, 1)
    feet = torch.stack([target[f"{side}_foot_position"] for side in SIDES], -2)
    state = WalkState.from_rows(walk["plan", "state"].flatten(0, 1))
    borne = (state.since / default_planner().program.pendulum.double_stance).clamp(max=1)[:, None]
    stance = torch.arange(2) == state.stance[:, None]
    feet[..., 2] += _YIELD * torch.where(stance, 1 - borne, borne)
    toes = torch.cat([target[f"{side}_foot_heading"] for side in SIDES], -1)
    # the frame turns with the body
    angle, _ = LegTable().motors(feet, toes - target["body_heading"])
    found = walk["reference", "motor_position"].flatten(0, 1)
    torch.testing.assert_close(found, angle, rtol=0, atol=2e-5)


def test_motor_torques_carry_and_accelerate_the_legs(walk: Any) -> None:
    """They are those of differences of the motor angles, in feet that fly and stand."""
    state = WalkState.from_rows(walk["plan", "state"][:, 9:15].flatten(0, 1).double())
    planner = BatchPlanner(default_planner().program)
    plan = planner.plan(state, torch.tensor([[0.5, 0.1, 0.3]]).double().expand(len(state.since), 3))
    at, step, legs = 0.03 + 0 * state.since, 1e-3, LegTable()
    samples = [plan.sample(at + k * step) for k in (-3, 3, -1, 1, 0)]
    motors = PlanMotors(planner.program.pendulum)
    turn: Any = samples[-1].heading.angle[:, None]
    motors = motors(samples[-1], (samples[0], samples[1]))
    feet = [_feet(sample) for sample in samples]
    before, after, angle = (legs.motors(*x)[0] for x in feet[2:])
    velocity, acceleration = (after - before) / (2 * step), (after - 2 * angle + before) / step**2
    force: Any = samples[-1].ground_force
    pendulum = planner.program.pendulum
    push = rotate_about_vertical(force.sum(1) / pendulum.mass, -turn)
    push[:, 2] -= pendulum.gravity
    carried = legs.torque(*feet[-1], _turned(force, -turn))
    expected = carried + legs.inertial_torque(angle, velocity, acceleration, push)
    # not at touchdowns, where a motor gets to its limit, or a fall changes the acceleration
    first, last = (legs.motors(*x)[0] for x in feet[:2])
    smooth = (samples[0].stance == samples[1].stance) & ((first == angle) == (last == angle)).all(1)
    smooth &= acceleration.abs().amax(1) < 100
    coarse = (first - 2 * angle + last) / (3 * step) ** 2
    smooth &= (coarse - acceleration).abs().amax(1) < 5
    assert smooth.sum() > NUM
    assert (expected - carried)[smooth].abs().amax() > 20
    for name, value, error in (("torque", expected, 2.0), ("velocity", velocity, 0.2)):
        found = motors[f"motor_{name}"]
        torch.testing.assert_close(found[smooth], value[smooth], rtol=0, atol=error)


def test_a_foot_that_stops_at_its_touchdown_accelerates_no_motor() -> None:
    """Counted as an acceleration, the speed that it loses would add 70 N m."""
    planner = BatchPlanner(default_planner().program)
    motors = PlanMotors(planner.program.pendulum)
    start = aslip.make_env(num_envs=1, seed=0, stack=planned_stack()).reset()["plan", "state"]
    state = WalkState.from_rows(cast("torch.Tensor", start).double())
    plan = planner.plan(state, torch.tensor([[0.5, 0.0, 0.0]]).double())
    torques = []
    for before in (0.001, 0.006):
        first, at, last = (plan.sample(plan.time[:, 1] - before + s) for s in (-NEAR, 0, NEAR))
        torques.append(motors(at, (first, last))["motor_torque"])
    assert (torques[0] - torques[1]).abs().amax() < 20


def test_random_footsteps_displace_the_next_foothold() -> None:
    walks = {}
    for size in (0.0, 0.1):
        env = aslip.make_env(num_envs=NUM, seed=3, stack=_planned(size, 0.0, share=1.0))
        # at a speed at which the limits leave room
        start = {"command": torch.tensor([[0.4, 0.0, 0.0]] * NUM), "stand": torch.zeros(NUM, 1)}
        walks[size] = env.reset(TensorDict(start, [NUM]))
    moved = walks[0.1]["plan", "foothold"] - walks[0.0]["plan", "foothold"]
    shift = walks[0.1]["footsteps", "shift"]
    assert moved[:, :2].norm(dim=-1).max() > 0.05
    torch.testing.assert_close(moved[:, :2], shift, rtol=0, atol=0.05)


def test_robots_without_stones_follow_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their reference is that of the stack `directions`; a plan on stones goes on from it."""
    stack = insert_before(planned_stack(), "reference", stones=OneStone())
    first = {"command": torch.tensor([[0.4, 0.1, 0.2]] * NUM), "stand": torch.zeros(NUM, 1)}
    first["phase"] = torch.linspace(0.0, 0.9, NUM)[:, None]
    walks = []
    for each in (stack, "directions"):
        env = aslip.make_env(num_envs=NUM, seed=3, stack=each, **ON_TRUTH)
        monkeypatch.setattr(OneStone, "robots", 2)
        td, found = env.reset(TensorDict(first, [NUM])), []
        for k in range(8):
            found.append(td.select("reference", "target", "phase", "odometry"))
            monkeypatch.setattr(OneStone, "robots", NUM if k > 5 else 2)
            td["command"] = first["command"]
            td = env.step_mdp(env.step(td.set("action", torch.zeros(NUM, 10))))
        walks.append(torch.stack([*found, td.select(*found[0].keys())], 1))
    ours, theirs = walks
    for name, value in ours[2:, :-2].flatten_keys().items():
        torch.testing.assert_close(value, theirs[2:, :-2].flatten_keys()[name])
    assert not torch.allclose(ours["phase"][:2, 1:-2], theirs["phase"][:2, 1:-2])
    for side in SIDES:
        name = f"{side}_foot_position"
        moved = (ours["reference", name][:, -1] - theirs["reference", name][:, -1])[2:]
        assert 1e-6 < moved.norm(dim=-1).max() < 0.1


class OneStone(SeededTransform):
    """A stone of 30 cm ahead of the odometry's pelvis, and places without stones."""

    robots = NUM
    """Number of the first robots that see it."""

    def __init__(self) -> None:
        keys: Any = [("stones", "corners"), ("stones", "height")]
        super().__init__([("odometry", "pelvis_position")], keys)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        at = cast("torch.Tensor", next_tensordict["odometry", "pelvis_position"])[:, None, None, :2]
        square = 0.15 * torch.tensor([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
        stone = at + square + torch.tensor([0.3, 0.0])
        nowhere = torch.full_like(stone, float("nan"))
        stone = torch.where(
            torch.arange(len(at))[:, None, None, None] < self.robots, stone, nowhere
        )
        next_tensordict.set(("stones", "corners"), torch.cat([nowhere, stone], 1))
        return next_tensordict.set(("stones", "height"), torch.zeros(len(at), 2))

    def transform_observation_spec(self, observation_spec: Any) -> Any:
        extend_spec(observation_spec, {("stones", "height"): 2})
        corners = observation_spec["stones", "height"].shape[:-1]
        observation_spec["stones", "corners"] = Unbounded(torch.Size((*corners, 2, 4, 2)))
        return observation_spec


@pytest.mark.parametrize("kind", [Planner, BatchPlanner])
def test_feet_land_on_stones(kind: type[Planner | BatchPlanner]) -> None:
    planner = kind(default_planner().program)
    stack = insert_before(planned_stack(planner=planner), "reference", stones=OneStone())
    env = aslip.make_env(num_envs=NUM, seed=3, stack=stack)
    start = {"command": torch.tensor([[0.6, 0.0, 0.0]] * NUM), "stand": torch.zeros(NUM, 1)}
    td = env.reset(TensorDict(start, [NUM]))
    place = td["plan", "foothold"][:, :2] - td["odometry", "pelvis_position"][:, :2]
    beyond = (place - torch.tensor([0.3, 0.0])).abs() - 0.15
    reached = td["plan", "on_stones"][:, 0] > 0
    assert reached.sum() >= 2
    assert beyond[reached].max() <= 1e-4


def test_a_reset_of_some_robots_leaves_the_others() -> None:
    env = aslip.make_env(num_envs=3, seed=3, stack=_planned())
    td = env.reset()
    td = env.step_mdp(env.step(td.set("action", torch.zeros(3, 10))))
    mask = torch.tensor([[False], [True], [False]])
    again = env.reset(td.clone().set("_reset", mask))
    for key in ("reference", "target", "plan", "odometry"):
        for name, value in cast("TensorDictBase", td[key]).items():
            assert torch.equal(again[key, name][[0, 2]], value[[0, 2]]), (key, name)
    assert not torch.equal(again["plan", "state"][1], td["plan", "state"][1])


def test_true_forces_tell_when_feet_land_without_an_estimator() -> None:
    """Plans on the truth go on to the second foot's landing, too."""
    env = aslip.make_env(num_envs=2, seed=3, stack=_planned(0.0, 0.0), **ON_TRUTH)
    td = env.reset(TensorDict({"stand": torch.zeros(2, 1)}, [2]))
    policy, stances = load_policy("stones"), []
    for _ in range(30):
        td = env.step_mdp(env.step(policy(td)))
        stances.append(WalkState.from_rows(cast("torch.Tensor", td["plan", "state"])).stance)
    assert (torch.stack(stances).diff(dim=0) != 0).sum(0).min() >= 2
    assert cast("torch.Tensor", td["reference", "motor_target"]).isfinite().all()


def test_policies_observe_the_command_of_the_plan() -> None:
    """Also those that have never seen one; stones decide how fast a plan is."""
    stack = insert_before(planned_stack(), "reference", stones=OneStone())
    stack["observation"] = AssembleObservation(planned_table(DIRECTION_TABLE))
    env = aslip.make_env(num_envs=2, seed=3, stack=stack)
    check_policy_fits("directions", env)
    command = torch.tensor([[1.2, 0.0, 0.3]]).expand(2, 3)
    td = env.reset(TensorDict({"command": command, "stand": torch.zeros(2, 1)}, [2]))
    of_plan = cast("torch.Tensor", td["plan", "filtered_command"])
    place = DIRECTION_TABLE.index("filtered_command")
    first = join_entries(td, stack["observation"].in_keys[:place]).shape[-1]
    assert torch.equal(td["observation"][:, first : first + 3], of_plan)
    assert (td["filtered_command"][:, 0] > 0.6).all()
    assert (of_plan - td["filtered_command"])[:, :2].norm(dim=1).min() > 0.02
    torch.testing.assert_close(of_plan[:, 2], td["filtered_command"][:, 2])


def test_policies_observe_where_and_when_the_next_foot_lands(walk: Any) -> None:
    plan, state = walk["plan"], WalkState.from_rows(walk["plan", "state"].flatten(0, 1))
    flies = plan["time"][..., 0] > CASSIE.policy_period  # the state is that a policy step later
    stood = state.of_foot(state.foot_position, swing=False).reshape(*flies.shape, 3)
    step, aim = plan["step"][flies], plan["foothold"][flies]
    torch.testing.assert_close(step[:, :2], aim[:, :2])
    torch.testing.assert_close(step[:, 2], (aim - stood[flies])[:, 2])
    torch.testing.assert_close(step[:, 3:4], plan["time"][flies])
    left = state.stance.reshape(flies.shape)[flies] == 0
    assert torch.equal(step[:, 4], 2.0 * left - 1)
    assert 0 < left.float().mean() < 1
    assert torch.equal(walk["observation"][..., -5:], plan["step"])
    env = aslip.make_env(num_envs=2, seed=3, stack="planned")
    stands = env.reset(TensorDict({"stand": torch.ones(2, 1)}, [2]))
    assert not stands["plan", "step"].any()


def test_a_foot_that_touches_the_ground_has_landed() -> None:
    """Before its time, if it is as low as its foothold; the next foot may lift off then."""
    env = aslip.make_env(num_envs=NUM, seed=3, stack=_planned(0.0, 0.0))
    td = env.reset(TensorDict({"stand": torch.zeros(NUM, 1)}, [NUM]))
    planned: Any = td["plan"].clone()
    led = WalkState.from_rows(planned["state"])
    swing = torch.arange(2) != led.stance[:, None]
    present: Any = td.clone()
    present["estimator", "contact"] = torch.ones(NUM, 2, dtype=torch.bool)
    for i, side in enumerate(SIDES):
        present["odometry", f"{side}_foot_position"][:, 2] = 0.1 * (torch.arange(NUM) == i)
    planned["time"][:] = 0.1
    planned["state"] = replace(led, since=led.since + 0.25).to_rows()
    reference = PlannedReference(shipped_library("directions"), stands=True)
    after = reference.go_on(td.clone().set("plan", planned), present)
    found = WalkState.from_rows(cast("torch.Tensor", after["plan", "state"]))
    low = ~(swing & (torch.arange(NUM)[:, None] == torch.arange(2))).any(1)
    assert torch.equal(found.stance != led.stance, low)
    assert (found.since[low] < 0.05).all()
