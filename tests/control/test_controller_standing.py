"""Controllers give the motor targets of stacks that stand, stop and start."""

import json
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Unbounded

import aslip
from aslip.base.archive import as_json
from aslip.control import Controller
from aslip.control.controller import _with_stones
from aslip.control.estimates import standing_estimate
from aslip.control.export import export_policy
from aslip.control.steering import Steering
from aslip.envs import StackEnv, insert_before
from aslip.envs.directions import course_stack, planned_stack
from aslip.envs.edit import Stack
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import GaitLibrary, WalkMode
from aslip.network.runner.supervisor import Limits
from aslip.planning import BatchPlanner, Planner
from aslip.policy import CARD, POLICY_FORMAT, check_policy_fits, policy_stack, read_card
from aslip.robot import CASSIE, NoiseLevel
from aslip.sim.course import stairs, stone_corners
from aslip.transforms import (
    COMMAND_RATES,
    DIRECTION_TABLE,
    SeededTransform,
    SeenStones,
    StandCommand,
)
from aslip.transforms.observation import PLANNED_TABLE
from aslip.transforms.plan_state import followed
from aslip.transforms.planned import default_planner
from aslip.transforms.rotation import rotate_about_vertical, yaw
from tests.control.helpers import compare_rollouts, small_actions, standing_packet
from tests.library.bent import symmetric_library
from tests.library.standing import policy_files, slower_library, standing_library

# numbers that policies of plans observe
PLANNED = 87


def _without_gaits(path: Path) -> Path:
    """Copy of a policy's file that does not tell its gaits."""
    entries, copy = POLICY_FORMAT.read(path), path.with_stem("other")
    card = json.loads(entries[CARD])
    card["library_sha256"] = None
    POLICY_FORMAT.write(copy, {**entries, CARD: as_json(card)})
    return copy


def _controller(stands: bool = True, planner: BatchPlanner | Planner | None = None) -> Controller:
    return Controller(
        small_actions(0.02) if planner is None else small_actions(0.02, PLANNED),
        standing_library(),
        observation=DIRECTION_TABLE if planner is None else PLANNED_TABLE,
        stands=stands,
        planner=planner,
    )


@pytest.fixture(scope="module")
def env() -> StackEnv:
    return _make(3)


def _make(num: int, stack: Stack | str = "directions") -> StackEnv:
    return aslip.make_env(
        stack=stack,
        library=standing_library() if isinstance(stack, str) else None,
        num_envs=num,
        seed=9,
        num_threads=1,
        drop=["low_reward"],
        replace={"stand": StandCommand(share=0.5)},
    )


@torch.no_grad()
@pytest.mark.parametrize("num", [1, 3])
def test_motor_targets_are_those_of_a_stacks_rollout(num: int) -> None:
    """With noise, changes of both commands, falls, and resets to walk and to stand."""
    keys = ("motor_target", "observation", "phase", "mode", "filtered_command")

    def change(step: int, td: TensorDictBase) -> None:
        if step % 20 == 3:
            stands = [[step % 40 < 20], [step % 40 > 20], [True]]
            td["stand"] = torch.tensor(stands[:num]).float()
            td["command"] = torch.tensor([[0.002, 0.0, -0.005]] * num) * step

    first = TensorDict(command=torch.tensor([[0.1, 0, 0.1]] * num), batch_size=num)
    walk = compare_rollouts(
        _make(num), small_actions(0.02), _controller(), keys, change, steps=90, first=first
    )
    modes = {mode for entries in walk for mode in cast("Any", entries)["mode"].flatten().tolist()}
    assert len(modes) == 4 or num == 1


class FromPelvis(SeededTransform):
    """Stones (1, m, e, 3) from the pelvis, placed as controllers do."""

    def __init__(self, stones: np.ndarray) -> None:
        keys: Any = [("stones", name) for name in ("place", "corners", "height")]
        super().__init__(["heading", ("odometry", "pelvis_position")], keys)
        self._stones = stones.astype(np.float32)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return _with_stones(cast("TensorDict", next_tensordict), self._stones)

    def transform_observation_spec(self, observation_spec: Any) -> Any:
        for key, shape in zip(self.out_keys, ((1, 4, 3), (1, 4, 2), (1,)), strict=True):
            observation_spec[key] = Unbounded(torch.Size((*observation_spec.shape, *shape)))
        return observation_spec


@torch.no_grad()
@pytest.mark.parametrize(
    ("planner", "seen"),
    [(BatchPlanner(), True), (default_planner(), True), (default_planner(), False)],
)
def test_motor_targets_of_planned_footsteps_are_those_of_a_rollout(
    planner: BatchPlanner | Planner, seen: bool
) -> None:
    """With noise, turns past a half turn, stops, starts, falls and resets, on a stone and off."""
    square = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    stone = np.pad(square, ((0, 0), (0, 1)), constant_values=-0.87)[None, None]

    def change(step: int, td: TensorDictBase) -> None:
        td["stand"] = torch.full_like(td["stand"], float(25 < step < 45))
        td["command"] = torch.tensor([[0.1, 0.0, 0.2 - 0.01 * step]])

    first = TensorDict(
        command=torch.tensor([[0.1, 0, 0.1]]), heading=torch.tensor([[3.1]]), batch_size=1
    )
    stack = planned_stack(standing_library(), planner=planner)
    keys = ("motor_target", "observation", "phase", "mode", ("plan", "foothold"))
    controller = _controller(planner=planner)
    policy = small_actions(0.02, PLANNED)
    if seen:
        stack = insert_before(stack, "reference", stones=FromPelvis(stone))
    stones = stone if seen else None
    walk = compare_rollouts(
        _make(1, stack), policy, controller, keys, change, steps=60, first=first, stones=stones
    )
    follows = [bool(followed(td)) for td in walk]
    assert any(follows) == seen


@torch.no_grad()
def test_stones_from_the_pelvis_are_where_a_stack_sees_them() -> None:
    """Also when they were sent once, and the robot has moved and turned since."""
    sight = SeenStones(noise=NoiseLevel(white=0.0, bias=0.0))
    stack = course_stack(planned_stack(standing_library()), [stairs(0.05), stairs(0.05)])
    env = _make(1, {**stack, "seen": sight})
    controller, policy = _controller(planner=default_planner()), small_actions(0.0, PLANNED)
    td = env.reset(TensorDict(heading=torch.tensor([[0.4]]), batch_size=1))
    state: Any = None
    for step in range(12):
        given = {"stand": td["stand"], "heading": td["heading"]}
        if step == 0:
            stones = _from_pelvis(td)
            state = controller.start(
                td["sensors"], td["command"], phase=td["phase"], stones=stones, **given
            )
        else:
            state, _ = controller.step(state, td["sensors"], td["command"], **given)
        ours = state.tensordict
        for name in ("corners", "height"):
            error = (ours["stones", name] - td["stones", name][:, :7]).abs().max()
            # later by what the estimated position has drifted
            assert error < (1e-5 if step == 0 else 0.02), (step, name)
        td = env.step(policy(td))["next"]


def _from_pelvis(td: TensorDictBase) -> np.ndarray:
    """Stones (1, s, 4, 3) of a course, from the true pelvis and along its yaw."""
    stones, truth = td["stones", "course"], cast("TensorDictBase", td["truth"])
    corners = stone_corners(stones)
    top = stones[..., None, 2:3].expand_as(corners[..., :1])
    place = torch.cat([corners, top], -1) - truth["pelvis_position"][:, None, None]
    return rotate_about_vertical(place, -yaw(truth["pelvis_orientation"])[:, None, None]).numpy()


def test_stones_need_a_planner_and_four_axes() -> None:
    packet = standing_packet()
    with pytest.raises(ConfigurationError, match="stones need a policy"):
        _controller().start(packet, stones=np.zeros((1, 1, 4, 3)))
    with pytest.raises(ShapeError, match=r"\(1, m, 3 or more, 3\), got \(4, 3\)"):
        _controller(planner=default_planner()).start(packet, stones=np.zeros((4, 3)))


def test_a_planner_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="follows a planner"):
        export_policy(_controller(planner=default_planner()), tmp_path / "policy.onnx")
    assert not [*tmp_path.iterdir()]


def test_a_stand_command_stays_until_the_next(env: StackEnv) -> None:
    standing = TensorDict(command=torch.zeros(3, 3), stand=torch.ones(3, 1), batch_size=3)
    packets, controller = env.reset(standing)["sensors"], _controller()
    state = controller.start(packets, [0.2, 0.0, 0.0], stand=True)
    entries = state.tensordict
    assert (entries["mode"] == WalkMode.STAND).all()
    assert not entries["filtered_command"].any()
    for _ in range(3):
        state, _ = controller.step(state, packets)
    assert torch.equal(state.tensordict["stand"], torch.ones(3, 1))
    assert torch.equal(state.tensordict["phase"], entries["phase"])
    walks = torch.tensor([[0.0], [1.0], [0.0]])
    for _ in range(2):
        state, _ = controller.step(state, packets, stand=walks)
        walks = None
    assert state.tensordict["mode"].flatten().tolist() == [3, 2, 3]


def test_robots_stand_before_the_runner_damps_them() -> None:
    """From the corners of the region, at any phase, with half a second to spare."""
    library = GaitLibrary.load("directions")
    rates, motor_lead, period = COMMAND_RATES, 0.0, CASSIE.policy_period
    steering = Steering(library, rates, True, motor_lead)
    low, high = (torch.tensor([axis[i] for axis in library.table.axes]) for i in (0, -1))
    corners = torch.cartesian_prod(*torch.stack([low, torch.zeros(3), high]).T).float()
    corners = library.nearest(torch.cat([corners, torch.tensor([[2.2, 0.0, 0.0]])]))
    command = corners.repeat_interleave(16, 0)
    phase = (torch.arange(len(command))[:, None] / 16) % 1
    stand = torch.ones(len(command), 1)
    present = steering.begin(command, phase, 0 * stand)
    upright = {name: torch.tensor(v).float() for name, v in standing_estimate(CASSIE).items()}
    for _ in range(round((Limits().settle - 0.5) / period)):
        present = steering.advance({**present, "estimate": upright}, command, stand)
    assert (present["mode"] == WalkMode.STAND).all()
    assert not present["filtered_command"].any()


def test_policy_files_name_the_stack_and_stand(env: StackEnv, tmp_path: Path) -> None:
    _, path = policy_files(tmp_path, standing_library())
    assert policy_stack(path) == "directions"
    check_policy_fits(path, env)
    packets, controller = env.reset()["sensors"], Controller(path, standing_library())
    assert (controller.start(packets, stand=1.0).tensordict["mode"] == WalkMode.STAND).all()
    with pytest.raises(ConfigurationError, match="needs a library with stop and start"):
        Controller(_without_gaits(path), symmetric_library())


def test_policies_walk_on_the_gaits_of_their_training_only(tmp_path: Path) -> None:
    """Others are refused, also if only stop and start differ."""
    library = standing_library()
    gaits, path = policy_files(tmp_path, standing_library())
    assert read_card(path)["library_sha256"] == library.sha256
    Controller(path, GaitLibrary.load(gaits))
    other = slower_library()
    words = f"other gaits: .*{library.sha256[:12]}, that of the given one with {other.sha256[:12]}"
    with pytest.raises(ConfigurationError, match=words):
        Controller(path, other)
    Controller(_without_gaits(path), other)


def test_robots_that_cannot_stand_refuse_the_command(env: StackEnv) -> None:
    packets, walking = env.reset()["sensors"], _controller(stands=False)
    state = walking.start(packets, stand=0.0)
    assert "stand" not in state.tensordict
    with pytest.raises(ConfigurationError, match="these robots cannot stand"):
        walking.start(packets, stand=True)
    with pytest.raises(ConfigurationError, match="these robots cannot stand"):
        walking.step(state, packets, stand=1.0)
