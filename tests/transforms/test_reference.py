"""Entries of the reference, feedforward, and starts on the reference."""

from dataclasses import fields

import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose

from aslip.envs import BatchEnv
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary, Reference
from aslip.robot import CASSIE
from aslip.transforms import PhaseClock, ReferenceInjection, ReferenceStart, SpeedCommand
from tests.helpers import MakeEnv


@pytest.mark.parametrize("lead", [1.0, 0.0, 0.5])
def test_the_reference_is_that_of_the_library(
    make: MakeEnv, library: GaitLibrary, lead: float
) -> None:
    """Body and feet are at the current phase, motor angles at the end of the policy step."""
    env = make(num_envs=16, replace={"reference": ReferenceInjection(library, motor_lead=lead)})
    start = env.reset()
    step = env.step(start.clone().set("action", torch.zeros(16, 10)))["next"]
    partly = env.reset(step.clone().set("_reset", torch.arange(16)[:, None] % 3 == 1))
    for td in (start, step, partly):
        present = library.lookup(td["phase"], td["command"])
        later = td["phase"] + lead * CASSIE.policy_period / library.stride(td["command"])
        following = library.lookup(later, td["command"])
        for field in fields(Reference):
            source = following if field.name.startswith("motor") else present
            expected = getattr(source, field.name)
            torch.testing.assert_close(td["reference", field.name], expected, rtol=0, atol=1e-6)
        same = torch.equal(following.motor_position, present.motor_position)
        assert same == (lead == 0)


def test_feedforward_gives_the_torque_of_the_model(make: MakeEnv) -> None:
    """A PD loop at the reference's angle and rate gives the reference's torque."""
    env = make(num_envs=16)
    start = env.reset()
    for td in (start, env.step(start.clone().set("action", torch.zeros(16, 10)))["next"]):
        reference = td["reference"]
        error = reference["motor_target"] - reference["motor_position"]
        torque = error * torch.tensor(CASSIE.stiffness)
        torque -= torch.tensor(CASSIE.damping) * reference["motor_velocity"]
        torch.testing.assert_close(torque.float(), reference["motor_torque"], rtol=1e-4, atol=1e-3)
        assert reference["motor_torque"].abs().max() > 100


def test_episodes_start_on_the_reference(make: MakeEnv, library: GaitLibrary) -> None:
    td = make(num_envs=8).reset()
    qpos, qvel = library.initial_state(td["phase"], td["command"])
    torch.testing.assert_close(td["truth", "qpos"], qpos, rtol=0, atol=0)
    torch.testing.assert_close(td["truth", "qvel"], qvel, rtol=0, atol=0)
    assert (qvel != 0).any(dim=1).all()


def test_a_reset_of_no_robot_changes_none(make: MakeEnv) -> None:
    env = make(num_envs=3)
    before = env.step(env.reset().set("action", torch.zeros(3, 10)))["next"]
    td = env.reset(before.clone().set("_reset", torch.zeros(3, 1, dtype=torch.bool)))
    for key in (("truth", "qpos"), ("estimate", "height"), ("reference", "body_position"), "phase"):
        assert torch.equal(td[key], before[key]), key


def test_episodes_may_start_at_rest(make: MakeEnv, library: GaitLibrary) -> None:
    td = make(num_envs=8, replace={"start": ReferenceStart(library, "rest")}).reset()
    qpos, _ = library.initial_state(td["phase"], td["command"])
    torch.testing.assert_close(td["truth", "qpos"], qpos, rtol=0, atol=0)
    assert (td["truth", "qvel"] == 0).all()


def test_a_start_after_the_command_is_refused(library: GaitLibrary) -> None:
    """Resets are prepared from the last transform to the first."""
    order = [SpeedCommand(library), PhaseClock(library), ReferenceStart(library)]
    env = TransformedEnv(BatchEnv(1, num_threads=1), Compose(*order))
    with pytest.raises(ConfigurationError, match="put it before SpeedCommand"):
        env.reset()


@pytest.mark.parametrize(
    ("transform", "key"),
    [("clock", "phase"), ("last_action", "last_action")],
)
def test_dropping_a_needed_transform_names_the_missing_entry(
    make: MakeEnv, transform: str, key: str
) -> None:
    with pytest.raises(UnknownNameError, match=key):
        make(drop=[transform])


def test_a_partial_reset_puts_some_robots_on_the_reference(
    make: MakeEnv, library: GaitLibrary
) -> None:
    env = make(num_envs=8)
    before = env.step(env.reset().set("action", torch.zeros(8, 10)))["next"]
    rows = torch.arange(8) % 3 == 1
    td = env.reset(before.clone().set("_reset", rows[:, None]))
    qpos, _ = library.initial_state(td["phase"], td["command"])
    assert torch.equal(td["truth", "qpos"][rows], qpos[rows])
    assert torch.equal(td["truth", "qpos"][~rows], before["truth", "qpos"][~rows])
