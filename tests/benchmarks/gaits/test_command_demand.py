"""Changes of the command slide the planted feet of the reference, and hardly load the motors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import torch
from torch import Tensor

from aslip.ik import Kinematics
from aslip.library import GaitLibrary
from aslip.robot import CASSIE, SIDES
from aslip.rom.arc import Pose, twist_pose
from benchmarks.gaits import command_demand
from benchmarks.gaits.command_demand import Config, change, steps

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

PERIOD = CASSIE.policy_period
START, END = (torch.tensor(c, dtype=torch.float64) for c in ([0.2, 0.0, 0.0], [0.9, 0.1, 0.3]))
Walk = tuple[Tensor, Tensor]


@pytest.fixture(scope="module")
def gaits() -> GaitLibrary:
    return GaitLibrary.load("directions")


@pytest.fixture(scope="module")
def walk(gaits: GaitLibrary) -> Walk:
    return steps(gaits, Config(), START, END, torch.tensor([0.5], dtype=torch.float64))


def test_a_change_ends_at_its_command_as_fast_as_the_rates_allow(
    gaits: GaitLibrary, walk: Walk
) -> None:
    phase, command = walk
    # 0.7 m/s forward at 1 m/s^2, in steps of 0.03 s
    assert len(phase) == len(command) == 2 + 24 + 2
    assert torch.equal(command[:2], START.expand(2, 3))
    assert torch.equal(command[-3:], END.expand(3, 3))
    stride = gaits.stride(command[:1]).item()
    assert (phase[-1] - phase[0]).item() % 1 == pytest.approx(27 * PERIOD / stride % 1, abs=0.01)


def test_sliding_feet_are_those_of_the_reference_in_the_world(
    gaits: GaitLibrary, walk: Walk
) -> None:
    """The moving frame goes along each command for a policy step."""
    phase, command = walk
    frame, places = Pose(np.zeros((1, 3)), np.zeros(1)), []
    for at, c in zip(phase, command, strict=True):
        motion = gaits.lookup(at[None], c[None])
        feet = [motion.body_position + getattr(motion, f"{s}_foot_position") for s in SIDES]
        places.append([frame.transform(foot.numpy())[0, :2] for foot in feet])
        step = twist_pose(c.numpy(), np.array([PERIOD]))
        frame = Pose(frame.transform(step.position), frame.angle + step.angle)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1) / PERIOD
    motion = gaits.lookup(phase, command)
    velocities = [getattr(motion, f"{s}_foot_velocity").norm(dim=-1).numpy() for s in SIDES]
    planted = np.stack(velocities, axis=1) < 1e-2
    both = planted[1:] & planted[:-1] & np.any(np.diff(command, axis=0), axis=1)[:, None]
    slide = change(gaits, Kinematics(), phase, command).slide
    assert slide.mean() > 0.05
    assert speed[both].mean() == pytest.approx(slide.mean(), rel=0.1)


def test_velocities_move_the_legs_from_step_to_step(gaits: GaitLibrary, walk: Walk) -> None:
    """Differences of the reference's configurations over 0.3 ms, the command on its way."""
    kinematics, (phase, command) = Kinematics(), walk
    found = change(gaits, kinematics, phase, command).changing.velocity
    part = 0.01
    stride, here = gaits.stride(command[1:-1]), command[1:-1]
    on = (phase[1:-1] + part * PERIOD / stride) % 1
    first, last = (
        kinematics.to_pinocchio(gaits.initial_state(at, c)[0].numpy())
        for at, c in ((phase[1:-1], here), (on, here + part * (here - command[:-2])))
    )
    pairs = zip(first, last, strict=True)
    rates = np.array([pin.difference(kinematics.model, *pair) for pair in pairs])
    expected = rates[:, CASSIE.indices.motor_qvel] / (part * PERIOD)
    np.testing.assert_allclose(found, expected, atol=0.05)


def test_a_held_command_asks_the_same_of_the_motors(gaits: GaitLibrary) -> None:
    phase, command = steps(gaits, Config(), END, END, torch.tensor([0.1], dtype=torch.float64))
    found = change(gaits, Kinematics(), phase, command)
    assert not len(found.slide)
    np.testing.assert_allclose(found.changing.torque, found.held.torque, atol=1e-9)


def test_faster_changes_slide_feet_faster_and_load_motors_more(
    capsys: pytest.CaptureFixture[str],
) -> None:
    slow, fast = (command_demand.main(Config(changes=3, faster=faster)) for faster in (1.0, 5.0))
    assert fast.slide.mean() > 3 * slow.slide.mean()
    more = [np.abs(f.changing.torque - f.held.torque).max() for f in (slow, fast)]
    assert more[1] > 2 * more[0] > 0
    assert "| hip pitch |" in capsys.readouterr().out
