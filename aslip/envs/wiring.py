"""Mistakes in how transforms are put together, told before the first step."""

from __future__ import annotations

from torchrl.envs.transforms import RewardSum

from aslip.envs.environment import CassieTransformedEnv
from aslip.errors import ConfigurationError
from aslip.transforms import (
    ActionDelta,
    EpisodeSum,
    EstimatedState,
    LastAction,
    LowReward,
    ObservationNoise,
    RewardTerm,
    WeightedReward,
)
from aslip.transforms.base import require_keys


def check_wiring(env: CassieTransformedEnv) -> None:
    """Check that what reward terms and the action read is there, before the first step needs it."""
    available = env.full_observation_spec.clone()
    available.update(env.full_action_spec)
    available.update(env.full_reward_spec)
    summed = rewarded = sensed = False
    ever_rewarded = any("reward" in transform.out_keys for transform in env.transforms)
    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        if isinstance(transform, RewardTerm) and summed:
            raise ConfigurationError(
                f"the reward term {transform.out_keys[0][-1]!r} comes after the sum and would not"
                ' count; insert_before(stack, "reward", ...) puts it in its place'
            )
        if getattr(transform, "must_be_last", False) and transform is not env.transforms[-1]:
            raise ConfigurationError(
                f"{name!r} must be the last transform, or what later ones write is not in its log;"
                f" the last one is {env.transform_names[-1]!r}"
            )
        # a sum of nothing is right where there is no reward; an end of all episodes is not
        reads = isinstance(transform, LowReward) or (
            isinstance(transform, EpisodeSum | RewardSum) and ever_rewarded
        )
        if reads and not rewarded:
            raise ConfigurationError(
                f"no transform before {name!r} writes the reward that it reads; without one, drop"
                " it, too"
            )
        if isinstance(transform, ObservationNoise) and sensed:
            raise ConfigurationError(
                f"{name!r} comes after what reads the sensors and would have no effect;"
                ' insert_before(stack, "estimator", ...) puts it in its place'
            )
        summed |= isinstance(transform, WeightedReward)
        rewarded |= "reward" in transform.out_keys
        sensed |= isinstance(transform, EstimatedState)
        if isinstance(transform, RewardTerm | ActionDelta):
            require_keys(transform, available, transform.in_keys)
        if isinstance(transform, LastAction):
            require_keys(transform, available, ["action"])
