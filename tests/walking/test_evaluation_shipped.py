"""The shipped policy walks at every speed, with plausible physics."""

import pytest

from aslip import GaitLibrary, load_policy, make_env
from aslip.walking import WalkResult, evaluate

SPEEDS = [0.0, 0.5, 1.0, 1.5, 2.0]


@pytest.fixture(scope="module")
def walks(library: GaitLibrary) -> list[WalkResult]:
    env = make_env(num_envs=len(SPEEDS), library=library, seed=0)
    return evaluate(load_policy("straight"), env, SPEEDS)


def test_shipped_policy_survives_every_speed(walks: list[WalkResult]) -> None:
    assert [walk.steps for walk in walks] == [400] * len(SPEEDS)


def test_mean_ground_force_equals_weight(walks: list[WalkResult]) -> None:
    """Over an episode the mean ground force equals the weight within 1 %."""
    assert [walk.weight_ratio for walk in walks] == pytest.approx([1.0] * len(SPEEDS), abs=0.01)


def test_mean_speed_increases_with_command(walks: list[WalkResult]) -> None:
    speeds = [walk.mean_speed for walk in walks]
    assert speeds == sorted(speeds)
    assert speeds == pytest.approx(SPEEDS, abs=0.3)
