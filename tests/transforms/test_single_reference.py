"""The single-reference baseline: rewards computed by hand, inputs, stack and training."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import ppo_aslip
import pytest
import torch

from aslip.library import single_reference_library
from aslip.policy import policy_stack
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.robot.model import load_model
from aslip.transforms import SINGLE_REFERENCE_TABLE, Fall, SpeedCommand
from aslip.transforms import single_reference as terms
from aslip.walking import Walker
from recipes.ppo_presets import environments
from recipes.ppo_settings import PRESETS
from tests.helpers import MakeEnv

STILL, SWINGING = torch.zeros(3), torch.tensor([1.0, 0.0, 0.5])


@pytest.fixture(scope="module")
def qpos() -> torch.Tensor:
    return torch.tensor(load_model().key("standing").qpos)


@pytest.mark.parametrize(("motor", "weight"), [("left_hip_roll", 0.15), ("right_knee", 0.05)])
def test_joint_errors_are_weighted(qpos: torch.Tensor, motor: str, weight: float) -> None:
    reference = qpos[list(CASSIE.indices.motor_qpos)]
    assert terms.joints(qpos, reference).item() == 1.0
    reference[CASSIE.motor_names.index(motor)] += 0.2
    assert terms.joints(qpos, reference).item() == pytest.approx(math.exp(-30 * weight * 0.04))


def test_the_pelvis_term_includes_the_distance_of_the_reference() -> None:
    body = torch.tensor([0.02, -0.01, 0.9])
    distance = torch.tensor([3.0])
    assert terms.pelvis(torch.tensor([3.02, -0.01, 0.9]), body, distance).item() == 1.0
    off = terms.pelvis(torch.tensor([3.32, -0.01, 0.5]), body, distance).item()
    assert off == pytest.approx(math.exp(-(0.09 + 0.16)), rel=1e-5)


def test_springs_carry_the_weight_in_stance(qpos: torch.Tensor) -> None:
    shins = CASSIE.indices.joint_qpos[[0, 3]]
    loaded = terms.SHIN_COMPLIANCE * CASSIE.total_mass * STANDARD_GRAVITY
    single, both = qpos.clone(), qpos.clone()
    single[shins] = torch.tensor([loaded, 0.0], dtype=qpos.dtype)
    both[shins] = loaded / 2
    assert terms.springs(single, STILL, SWINGING).item() == pytest.approx(1.0)
    assert terms.springs(both, STILL, STILL).item() == pytest.approx(1.0)
    wrong = terms.springs(single, SWINGING, STILL).item()
    assert wrong == pytest.approx(math.exp(-2000 * loaded**2), rel=1e-4)


def test_the_assumed_spring_compliance_is_that_of_the_robot() -> None:
    """Deflection and force of the shipped policy's robot fit the line that the reward assumes."""
    walker = Walker("straight", speed=0.5, seed=0)
    shins = CASSIE.indices.joint_qpos[[0, 3]]
    deflections, forces = [], []
    for _ in range(100):
        walker.step()
        truth = walker.td["truth"]
        deflections.append(truth["qpos"][0, shins].numpy())  # pyright: ignore
        forces.append(truth["ground_force"][0, :, 2].numpy())  # pyright: ignore
    slope = np.polyfit(np.ravel(forces), np.ravel(deflections), 1)[0]
    assert slope == pytest.approx(terms.SHIN_COMPLIANCE, rel=0.1)


def test_the_policy_sees_estimate_clock_and_speed(make: MakeEnv) -> None:
    env = make(num_envs=3, stack="single_reference", library=None)
    td = env.rollout(4)[:, -1]["next"]
    observation = td["observation"]
    assert observation.shape == (3, 49)
    angle = 2 * math.pi * td["phase"]
    torch.testing.assert_close(observation[:, 46:47], torch.sin(angle))
    torch.testing.assert_close(observation[:, 47:48], torch.cos(angle))
    assert torch.equal(observation[:, 48:], td["command"])
    estimate = torch.cat([td[key] for key in SINGLE_REFERENCE_TABLE[:-3]], dim=-1)
    assert torch.equal(observation[:, :46], estimate)


def test_the_distance_grows_at_the_speed_of_each_step(make: MakeEnv) -> None:
    """Also when commands change: each step adds its own command, and the target already has it."""
    library = single_reference_library()
    restless = SpeedCommand(library, [0.0, 1.0, 2.0], interval=CASSIE.policy_period)
    env = make(
        num_envs=8,
        stack="single_reference",
        library=library,
        drop=["low_reward", "fall"],
        replace={"command": restless},
    )
    walk = env.rollout(6, break_when_any_done=False)
    assert (walk["command"] != walk["next", "command"]).any()
    displacement = walk["next", "reference", "distance"] - walk["reference", "distance"]
    torch.testing.assert_close(
        displacement, CASSIE.policy_period * walk["command"], atol=1e-6, rtol=0
    )
    reached = walk["next", "reference", "distance"]
    torch.testing.assert_close(walk["target", "distance"], reached, atol=0, rtol=0)


def test_a_robot_on_its_shins_has_fallen(make: MakeEnv) -> None:
    """The limit is between the height of a kneeling robot and the reference's lowest."""
    env = make(stack="single_reference", num_envs=2)
    fall = next(t for t in env.transforms if isinstance(t, Fall))
    td = env.rand_step(env.reset())
    for height, over in ((0.65, True), (0.85, False)):
        td["next", "truth", "pelvis_position"][:, 2] = height
        for key in ("terminated", "done"):
            td["next", key] = torch.zeros(2, 1, dtype=torch.bool)
        after = fall._step(td, td["next"])
        assert (after["terminated"] == over).all()
        assert (after["done"] == over).all()


def test_the_recipe_saves_the_name_of_the_stack(tmp_path: Path) -> None:
    config = replace(
        PRESETS["single_reference"], out=tmp_path, num_envs=4, samples=32, total_steps=32,
        minibatch=16, eval_steps=5,
    )  # fmt: skip
    ppo_aslip.main(config, **environments(config))
    assert policy_stack(tmp_path) == "single_reference"
    walker = Walker(tmp_path, speed=1.0, seed=0)
    assert walker.step()["observation"].shape == (1, 49)


def test_single_reference_terms_read_the_documented_entries(make: MakeEnv) -> None:
    env = make(num_envs=16, stack="single_reference", library=None)
    td = env.reset()
    data = env.step(td.set("action", torch.full((16, 10), 0.05)))
    truth, reference = data["next", "truth"], data["next", "reference"]
    feet = [reference[f"{side}_foot_velocity"] for side in ("left", "right")]
    expected = {
        "joints": terms.joints(truth["qpos"], data["reference", "motor_position"]),
        "pelvis": terms.pelvis(
            truth["pelvis_position"], reference["body_position"], reference["distance"]
        ),
        "upright": terms.upright(truth["pelvis_orientation"]),
        "springs": terms.springs(truth["qpos"], *feet),
    }
    for name, value in expected.items():
        torch.testing.assert_close(
            data["next", "reward_terms", name], value.float(), rtol=0, atol=1e-6, msg=name
        )
