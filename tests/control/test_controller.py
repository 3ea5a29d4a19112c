"""Controllers give the motor targets of training stacks, without a simulator."""

import math
from functools import cache, partial
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torchrl.modules import GRUModule

import aslip
from aslip.control import Controller
from aslip.envs import StackEnv, insert_before
from aslip.envs.stacks import STACKS
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.policy import policy_library, policy_stack, read_card, save_policy
from aslip.policy.networks import PolicyShape, RunningNormalizer, make_actor
from aslip.robot import CASSIE
from aslip.transforms import SINGLE_REFERENCE_TABLE, SeededTransform
from tests.control.helpers import compare_rollouts

QUARTER = math.pi / 2


class Losses(SeededTransform):
    """Lose some packets: single readings, whole packets, and all packets of a policy step."""

    def __init__(self) -> None:
        super().__init__(in_keys=[("sensors", "gyro")], out_keys=[])
        self.steps = 0

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.steps += 1
        sensors = cast("TensorDictBase", next_tensordict["sensors"])
        if self.steps % 5 == 0:
            sensors["gyro"][-1, 3:5, 0] = math.nan
        if self.steps % 7 == 0:
            for entry in sensors.values():
                entry[0, 8:] = math.nan
        if self.steps % 23 == 0:
            for entry in sensors.values():
                entry[:] = math.nan
        return next_tensordict


@cache
def gaits(stack: str) -> GaitLibrary:
    return GaitLibrary.load("single_reference" if stack == "single_reference" else "gaits")


def make_rollout_env(name: str, num: int) -> StackEnv:
    library = gaits(name)
    stack = insert_before(STACKS[name](library), "estimator", losses=Losses())
    return aslip.make_env(stack=stack, num_envs=num, seed=5, num_threads=1, drop=["low_reward"])


def follow(env: StackEnv, policy: TensorDictModuleBase, controller: Controller, *keys: str) -> None:
    """Compare a rollout in which commands and headings change."""
    num = env.num_envs

    def change(step: int, td: TensorDictBase) -> None:
        if step % 13 == 8:
            td["command"] = torch.full((num, 1), 0.1 * step % 2)
        if step == 30:
            td["heading"] = td["heading"] + QUARTER

    first = TensorDict(heading=torch.linspace(0.1, QUARTER, num)[:, None], batch_size=num)
    list(compare_rollouts(env, policy, controller, keys, change, steps=90, first=first))


@torch.no_grad()
@pytest.mark.parametrize("num", [1, 4])
@pytest.mark.parametrize("name", ["straight", "robust", "single_reference"])
def test_motor_targets_are_those_of_a_stacks_rollout(name: str, num: int) -> None:
    """With noise, lost packets, changes of command and heading, falls and resets."""
    env = make_rollout_env(policy_stack(name), num)
    controller = Controller(name, gaits(policy_stack(name)))
    keys = ("motor_target", "observation", "phase", "estimator")
    follow(env, aslip.load_policy(name), controller, *keys)


@torch.no_grad()
def test_a_recurrent_policy_remembers_and_forgets_as_in_the_stack() -> None:
    torch.manual_seed(3)
    gru = GRUModule(
        input_size=64,
        hidden_size=8,
        in_keys=["observation", "recurrent_state", "is_init"],
        out_keys=["embedding", ("next", "recurrent_state")],
    )
    head = TensorDictModule(torch.nn.Linear(8, 10), in_keys=["embedding"], out_keys=["action"])
    policy = TensorDictSequential([gru, head])
    env = make_rollout_env("straight", 1)
    env.append_transform(gru.make_tensordict_primer())
    follow(env, policy, Controller(policy, gaits("straight")), "action")


def _packets(num: int = 1) -> np.ndarray:
    """(num, 10, 42) packets of robots that begin to walk."""
    td = make_rollout_env("straight", num).reset()
    return np.concatenate([entry.numpy() for entry in td["sensors"].values()], axis=-1)


def test_a_step_changes_no_state_that_it_was_given(controller: Controller) -> None:
    packets = _packets(2)
    state = controller.start(packets, 0.5)
    before = state.tensordict.clone()
    once = controller.step(state, packets)[0].tensordict
    again = controller.step(state, packets)[0].tensordict
    assert (before == state.tensordict).all()
    assert (once == again).all()


def test_one_packet_of_one_robot_and_named_entries_are_packets(controller: Controller) -> None:
    packets = _packets()
    ends = np.cumsum([10, 10, 6, 6, 4, 3])
    named = dict(zip(CASSIE.packet_sizes, np.split(packets, ends, axis=-1), strict=True))
    expected = controller.start(packets).motor_target
    assert expected.shape == (1, 10)
    assert torch.equal(controller.start(named).motor_target, expected)
    assert torch.equal(controller.start(packets[0, -1]).motor_target, expected)


def test_lost_packets_leave_the_clock_running(controller: Controller) -> None:
    state = controller.start(_packets(2), 1.0)
    after, target = controller.step(state, None)
    assert (after.tensordict["estimator", "faults"][:, 0]).all()
    assert (after.tensordict["phase"] > state.tensordict["phase"]).all()
    assert target.isfinite().all()


def test_speeds_beyond_the_library_are_those_of_its_nearest_gait(controller: Controller) -> None:
    packets = _packets()
    fastest = controller.start(packets, float(controller.library.speeds[-1]))
    assert torch.equal(controller.start(packets, 99.0).motor_target, fastest.motor_target)


@pytest.mark.parametrize("name", ["command", "phase"])
def test_a_wrong_command_or_phase_is_named(controller: Controller, name: str) -> None:
    packets = _packets(2)
    with pytest.raises(ConfigurationError, match=f"{name} must be finite"):
        controller.start(packets, **{name: math.nan})  # pyright: ignore[reportArgumentType]
    with pytest.raises(ShapeError, match=f"{name} must be one number or \\(2, 1\\)"):
        controller.start(packets, **{name: torch.zeros(3, 1)})  # pyright: ignore


def test_shipped_policies_walk_on_the_gaits_of_their_training_only() -> None:
    for policy in ("straight", "robust", "single_reference"):
        own = policy_library(policy)
        assert read_card(policy)["library_sha256"] == own.sha256
        other = gaits("gaits" if own.name == "single_reference" else "single_reference")
        hashes = rf"{own.sha256[:12]}.*{other.name!r} with {other.sha256[:12]}"
        with pytest.raises(ConfigurationError, match=f"{policy!r} follows other gaits.*{hashes}"):
            Controller(policy, other)


def test_an_unknown_entry_is_named() -> None:
    table = (*SINGLE_REFERENCE_TABLE, "height_map")
    controller = Controller(aslip.load_policy("straight"), gaits("straight"), observation=table)
    with pytest.raises(UnknownNameError, match=r"cannot observe 'height_map'.*clock/sin"):
        controller.start(_packets())


def test_a_policy_with_another_kind_of_action_is_refused(tmp_path: Path) -> None:
    shape, path = PolicyShape(), tmp_path / "policy.zip"
    actor = make_actor(RunningNormalizer(shape.observation_size), shape)
    save_policy(path, actor, shape, baseline=None)
    make = partial(Controller, path, gaits("straight"))
    with pytest.raises(ConfigurationError, match="not a delta"):
        make()
    assert make(baseline=("reference", "motor_position")).baseline[-1] == "motor_position"
