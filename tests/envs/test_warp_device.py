"""No entry of a step visits the host: a simulated device notes what would."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import aslip
from aslip.envs import StackEnv, WarpEnv, default_stack, directions_stack, randomise_stack
from aslip.policy import load_policy
from aslip.sim import Snapshot
from aslip.sim.warp import WarpSimulations
from aslip.transforms import device_estimator
from tests.elsewhere import DEVICE, VISITS, Elsewhere, OnElsewhere, here, there


class _Simulations(WarpSimulations):
    """Simulations on the CPU whose tensors are elsewhere."""

    def __init__(
        self, num: int, model: Any, place: torch.device, *args: Any, **limits: Any
    ) -> None:
        super().__init__(num, model, torch.device("cpu"), *args, **limits)
        self.snapshot = Snapshot(**there(vars(self.snapshot)))
        self.packets = there(self.packets)

    def reset(self, ids: Tensor, qpos: Tensor | None = None, qvel: Tensor | None = None) -> None:
        super().reset(*here((ids, qpos, qvel)))

    def advance(self, motor_target: Tensor, push: Tensor | None = None) -> Tensor:
        return Elsewhere(super().advance(*here((motor_target, push))))

    def write_fields(self, ids: Tensor, fields: Any) -> None:
        super().write_fields(here(ids), here(dict(fields)))


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Robots, estimator and random numbers elsewhere."""
    step, generator = device_estimator.step, torch.Generator
    monkeypatch.setattr("aslip.envs.warp.WarpSimulations", _Simulations)
    monkeypatch.setattr("aslip.envs.warp.check_device", lambda _: DEVICE)
    monkeypatch.setattr(device_estimator, "step", lambda *arrays: step(*here(list(arrays))))
    monkeypatch.setattr(torch, "Generator", lambda *_: generator())
    with OnElsewhere(), torch.no_grad():
        yield


def _walk(env: StackEnv, policy: Any) -> list[list[str]]:
    """Visits of the host in each policy step; a robot's episode ends in the second one."""
    td, visits = env.reset(), []
    for step in range(3):
        VISITS.clear()
        td = policy(td)
        if step == 1:
            td["steps_left"] = torch.ones_like(td["steps_left"]) if "steps_left" in td else None
        _, td = env.step_and_maybe_reset(td)
        visits.append(list(VISITS))
    assert all(entry.device == DEVICE for entry in td.values(True, True))
    return visits


@pytest.mark.parametrize("name", ["straight", "directions"])
def test_no_entry_of_a_step_visits_the_host(elsewhere: None, name: str) -> None:
    """Only single numbers do, which decide whether a robot is reset or an entry is wrong."""
    stack = randomise_stack({"straight": default_stack, "directions": directions_stack}[name]())
    env = aslip.make_env("warp", num_envs=3, seed=0, stack=stack)
    assert isinstance(env.base_env, WarpEnv) and env.device == DEVICE
    visits = _walk(env, load_policy(name).to(DEVICE))
    assert all({*visited} <= {"number", "wait"} for visited in visits)
    assert max(map(len, visits)) < 40
