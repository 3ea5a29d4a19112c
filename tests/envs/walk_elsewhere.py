"""Program that walks robots on a simulated device, and prints what of each step visits the host.

A process of its own: the device would stay known to torch in all later tests.
"""

from __future__ import annotations

import json
from typing import Any

import torch
from torch import Tensor

import aslip
from aslip.envs import (
    MAX_EPISODE_STEPS,
    StackEnv,
    default_stack,
    directions_stack,
    insert_before,
    randomise_stack,
    warp,
)
from aslip.policy import load_policy
from aslip.sim import Snapshot
from aslip.sim.course import stairs
from aslip.sim.warp import WarpSimulations
from aslip.transforms import RandomCourse, SeenStones, device_estimator
from tests.elsewhere import DEVICE, VISITS, Elsewhere, Generator, OnElsewhere, here, there


class _Simulations(WarpSimulations):
    """Simulations on the CPU whose tensors are elsewhere."""

    def __init__(
        self, num: int, model: Any, place: torch.device, *args: Any, **limits: Any
    ) -> None:
        with torch.device("cpu"):
            super().__init__(num, model, torch.device("cpu"), *args, **limits)

    def snapshot(self) -> Snapshot:
        return Snapshot(**there(vars(super().snapshot())))

    def packets(self) -> Any:
        return there(dict(super().packets()))

    def reset(self, ids: Tensor, qpos: Tensor | None = None, qvel: Tensor | None = None) -> None:
        super().reset(*here((ids, qpos, qvel)))

    def advance(self, motor_target: Tensor, push: Tensor | None = None) -> Tensor:
        return Elsewhere(super().advance(*here((motor_target, push))))

    def write_fields(self, ids: Tensor, fields: Any) -> None:
        super().write_fields(here(ids), here(dict(fields)))


def _walk(env: StackEnv, policy: Any) -> list[list[str]]:
    """Visits of the host in each policy step; a robot's episode ends in the second one."""
    td, visits = env.reset(), []
    for step in range(3):
        VISITS.clear()
        td = policy(td)
        if step == 1:
            td["step_count"][1] = MAX_EPISODE_STEPS - 1
        _, td = env.step_and_maybe_reset(td)
        visits.append(list(VISITS))
        if step == 1:
            assert here(td["step_count"])[:, 0].tolist() == [2, 0, 2]
    assert all(entry.device == DEVICE for entry in td.values(True, True))
    return visits


def main() -> None:
    """Walk on two stacks."""
    step = device_estimator.step
    warp.WarpSimulations = _Simulations
    warp.check_device = lambda _: DEVICE
    device_estimator.step = lambda *arrays: step(*here(list(arrays)))
    torch.Generator = Generator
    straight = insert_before(default_stack(), "start", course=RandomCourse([stairs(0.1, steps=2)]))
    straight = insert_before(straight, "observation", stones=SeenStones())
    stacks = {"straight": straight, "directions": directions_stack()}
    with OnElsewhere(), torch.no_grad():
        for name, stack in stacks.items():
            env = aslip.make_env("warp", num_envs=3, seed=0, stack=randomise_stack(stack))
            assert env.device == DEVICE
            print(json.dumps(_walk(env, load_policy(name).to(DEVICE))))


if __name__ == "__main__":
    main()
