"""Walks at the rate of the physics agree with those at the rate of the policy."""

from contextlib import closing
from dataclasses import fields

import numpy as np
import pytest

import aslip
from aslip.envs import EPISODE_ENDS
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE
from aslip.walking import Substeps, Walks, record_substeps, record_walks
from tests.helpers import MakeEnv, limp

COMMAND = np.full(20, 0.5)


@pytest.fixture(scope="module")
def both() -> tuple[Substeps, Walks]:
    """One walk, recorded at both rates."""
    policy = aslip.load_policy("straight")
    with closing(aslip.make_env(drop=EPISODE_ENDS, num_threads=1, seed=3)) as env:
        walks = record_walks(policy, env, COMMAND[:, None])
    with closing(aslip.make_env(drop=EPISODE_ENDS, num_threads=1, seed=3)) as env:
        return record_substeps(policy, env, COMMAND), walks


def test_substeps_agree_with_policy_steps(both: tuple[Substeps, Walks]) -> None:
    """The robot walks along the world's x, so that heading frame and world agree."""
    substeps, walks = both
    assert not substeps.fell
    assert {len(getattr(substeps, f.name)) for f in fields(substeps) if f.name != "fell"} == {1200}
    last = np.arange(1, 21) * CASSIE.substeps - 1
    for name in ("pelvis_position", "foot_position"):
        found, expected = getattr(substeps, name)[last], getattr(walks, name)[:, 0]
        np.testing.assert_allclose(found, expected, atol=2e-3, err_msg=name)
    means = substeps.ground_force.reshape(20, CASSIE.substeps, 2, 3).mean(axis=1)
    np.testing.assert_allclose(means, walks.ground_force[:, 0], rtol=1e-5, atol=1e-3)
    # motors move the joints, and their torque is within limits
    assert np.abs(substeps.motor_velocity).max() > 1.0
    limit = CASSIE.torque_limit * CASSIE.gear
    assert (np.abs(substeps.motor_torque) <= limit + 1e-9).all()
    assert np.abs(substeps.motor_torque).max() > 10.0


def test_rest_of_a_walk_begins_at_its_time(both: tuple[Substeps, Walks]) -> None:
    substeps = both[0]
    rest = substeps.since(0.3)
    np.testing.assert_array_equal(rest.ground_force, substeps.ground_force[600:])
    np.testing.assert_array_equal(rest.motor_torque, substeps.motor_torque[600:])


def test_record_ends_in_a_fall(make: MakeEnv) -> None:
    def fails(td):
        td["action"] = td["observation"][..., :10] * np.nan
        return td

    env = make(num_envs=1, drop=EPISODE_ENDS)
    walk = record_substeps(fails, env, COMMAND)  # pyright: ignore[reportArgumentType]
    assert walk.fell
    assert len(walk.ground_force) == CASSIE.substeps


def test_refuses_several_robots_and_wrong_commands(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match="one simulated robot, got 2"):
        record_substeps(limp(), make(num_envs=2), COMMAND)
    with pytest.raises(ShapeError, match="command"):
        record_substeps(limp(), make(num_envs=1), COMMAND[:, None])
