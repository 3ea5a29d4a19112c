"""Rollouts, policies, exported files and estimates for tests of controllers."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor

from aslip.control import Controller
from aslip.control.contract import seal
from aslip.control.estimates import split_estimate
from aslip.envs import StackEnv
from aslip.policy import PolicyShape, RunningNormalizer, make_recurrent_actor
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.transforms import DIRECTION_TABLE
from tests.library.standing import standing_library


def small_actions(scale: float, inputs: int = 82) -> TensorDictModule:
    """Untrained network for all directions, whose actions are at most `scale` [rad]."""
    torch.manual_seed(4)
    net = torch.nn.Sequential(torch.nn.Linear(inputs, 10), torch.nn.Tanh())
    return TensorDictModule(
        lambda seen: scale * net(seen), in_keys=["observation"], out_keys=["action"]
    )


def compare_rollouts(
    env: StackEnv,
    policy: TensorDictModuleBase,
    controller: Controller,
    keys: Sequence[str | tuple[str, str]],
    change: Callable[[int, TensorDictBase], Any],
    *,
    steps: int,
    first: TensorDict,
    stones: np.ndarray | None = None,
) -> Iterator[TensorDictBase]:
    """Check that a controller repeats a rollout bit for bit, and yield its entries at each step.

    A single robot starts again whenever the environment resets it. Of several, each is compared
    until its first reset.

    Args:
        env: environment, whose rollout has noise.
        policy: policy that acts in the environment.
        controller: controller of the same policy.
        keys: entries that are compared.
        change: function that changes commands and headings before a step.
        steps: number of policy steps.
        first: entries of the reset.
        stones: (n, m, e, 3) stones that the controller is given in every step.
    """

    def commands(td: TensorDictBase) -> dict[str, Tensor]:
        names = ["command", *(["stand"] if controller.stands else [])]
        return {name: cast("Tensor", td[name]) for name in names}

    def start(td: TensorDictBase) -> Any:
        given = {**commands(td), "phase": td["phase"], "heading": td["heading"]}
        return controller.start(cast("Any", td["sensors"]), stones=stones, **given)

    td = env.reset(first)
    state, same = start(td), torch.ones(len(td), dtype=torch.bool)
    restarts = 0
    for step in range(steps):
        change(step, td)
        heading = td["heading"]
        td, following = env.step_and_maybe_reset(policy(td))
        ours: Any = state.tensordict[same]
        theirs: Any = env.transform.inv(td)[same]
        for key in keys:
            assert (ours[key] == theirs[key]).all(), (step, key)
        yield state.tensordict
        done = td["next", "done"][:, 0]
        restarts += int(done.sum())
        same &= ~done
        if len(td) == 1 and done.any():
            state, same = start(following), ~same
        else:
            state, _ = controller.step(
                state,
                cast("Any", following["sensors"]),
                **commands(following),
                heading=heading,
                stones=stones,
            )
        td = following
    assert restarts > 0


def recurrent_controller() -> Controller:
    """Controller with an untrained GRU policy of large actions that walks anywhere, and stands."""
    torch.manual_seed(3)
    normalizer = RunningNormalizer(82)
    normalizer.update(torch.randn(100, 82))
    shape = PolicyShape(observation_size=82, hidden=(16, 16))
    actor = make_recurrent_actor(normalizer, shape)
    for name, weight in actor.named_parameters():
        if name.endswith("weight"):
            weight.data.mul_(3.0)
    policy = actor.eval().requires_grad_(False)
    return Controller(policy, standing_library(), observation=DIRECTION_TABLE, stands=True)


def estimate(row: np.ndarray) -> dict[str, np.ndarray]:
    """Entries of an estimate from a row of a golden trace."""
    return split_estimate(row[None], CASSIE)


def standing_packet() -> np.ndarray:
    """Packet (p,) of a robot that stands upright."""
    at, packet = CASSIE.packet_slices, np.zeros(CASSIE.packet_size)
    packet[at["motor_position"]] = CASSIE.standing[CASSIE.indices.motor_qpos]
    packet[at["joint_position"]] = CASSIE.standing[CASSIE.indices.joint_qpos]
    packet[at["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    packet[at["accelerometer"]] = [0.0, 0.0, STANDARD_GRAVITY]
    return packet


def altered(source: Path, target: Path, **metadata: str) -> Path:
    """Copy of an exported policy with other metadata, sealed again."""
    model = onnx.load_from_string(source.read_bytes())
    entries = {prop.key: prop.value for prop in model.metadata_props if prop.key != "sha256"}
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {**entries, **metadata})
    target.write_bytes(seal(model.SerializeToString()))
    return target
