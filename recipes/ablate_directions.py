"""Ablations of walks in all directions: each part of the method."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from functools import partial
from typing import Any

import ppo_directions
import torch
from ablate_settings import Config
from ablation import Experiment, Variant, without_terms
from ppo_directions import DirectionConfig
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite

import aslip
from aslip.envs import (
    MAX_EPISODE_STEPS,
    Stack,
    directions_stack,
    evaluation_stack,
    insert_before,
    randomise_stack,
)
from aslip.library import GaitLibrary
from aslip.policy import make_recurrent_actor
from aslip.training.environments import make_evaluation_env
from aslip.transforms import (
    DIRECTION_TABLE,
    WIDE_RANGES,
    AssembleObservation,
    ReferenceInjection,
    SeededTransform,
    StandClock,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import DIRECTION_WEIGHTS
from aslip.transforms.rotation import (
    multiply,
    rotate_about_vertical,
    upper_hemisphere,
    vertical_quaternion,
)
from aslip.walking import WalkResult, evaluate

_STEP_SECONDS = 1.2e-3  # of one core


class WorldFrame(SeededTransform):
    """Write the estimated orientation and velocity in a frame that does not turn with the path.

    Entries are `("world", "orientation")` (n, 4), wxyz with w >= 0, `("world", "velocity")` (n, 3)
    [m/s], and the direction of the path there, the unit vector `("world", "direction")` (n, 2).
    """

    def __init__(self) -> None:
        super().__init__(
            in_keys=[("estimate", "orientation"), ("estimate", "velocity"), "heading"],
            out_keys=[("world", name) for name in ("orientation", "velocity", "direction")],
        )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        orientation, velocity, heading = (next_tensordict[key] for key in self.in_keys)
        turned = multiply(vertical_quaternion(heading), orientation)
        next_tensordict.set(self.out_keys[0], upper_hemisphere(turned))
        next_tensordict.set(self.out_keys[1], rotate_about_vertical(velocity, heading))
        direction = torch.cat([heading.cos(), heading.sin()], dim=-1)
        return next_tensordict.set(self.out_keys[2], direction)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries."""
        return extend_spec(observation_spec, dict(zip(self.out_keys, (4, 3, 2), strict=True)))


class NearestGait(SeededTransform):
    """Write the command of the nearest gait of a library as `gait_command` (n, c).

    Distances along an axis count relative to the range of the library.

    Args:
        library: the gaits.
    """

    def __init__(self, library: GaitLibrary) -> None:
        super().__init__(in_keys=["filtered_command"], out_keys=["gait_command"])
        table = library.table
        self._commands = torch.from_numpy(table.commands).float()
        self._range = torch.tensor([float(axis[-1] - axis[0]) or 1.0 for axis in table.axes])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = next_tensordict[self.in_keys[0]]
        far = torch.cdist(command / self._range, self._commands / self._range)
        return next_tensordict.set(self.out_keys[0], self._commands[far.argmin(-1)])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the command."""
        return extend_spec(observation_spec, {self.out_keys[0]: self._commands.shape[-1]})


def in_world_frame(library: GaitLibrary) -> Stack:
    """Stack whose policy observes orientation, velocity and path in the world."""
    moved: Mapping[NestedKey, NestedKey] = {
        ("estimate", name): ("world", name) for name in ("orientation", "velocity")
    }
    table = [*(moved.get(key, key) for key in DIRECTION_TABLE), ("world", "direction")]
    stack = insert_before(directions_stack(library), "observation", world=WorldFrame())
    return {**stack, "observation": AssembleObservation(table)}


def with_independent_gaits(library: GaitLibrary) -> Stack:
    """Stack whose reference is always a gait of the library, and jumps between them."""
    stack = insert_before(directions_stack(library), "clock", nearest_gait=NearestGait(library))
    stack["clock"] = StandClock(library, "gait_command")
    keys: list[NestedKey] = ["gait_command", "phase", "mode", "stand"]
    stack["reference"] = ReferenceInjection(library, in_keys=keys)
    return stack


VARIANTS: Mapping[str, Variant] = {
    "default": Variant("everything"),
    "no_randomise": Variant(
        "nominal robots, floors, sensors and motor encoders", {"randomise": False}
    ),
    "no_pushes": Variant("no pushes", {"push_impulse": 0.0}),
    "no_privileged": Variant("a critic that sees what the policy sees", {"privileged": False}),
    "no_curriculum": Variant("full ranges and pushes from the start", {"ramp": 0.0}),
    "no_effort": Variant(
        "no reward for low power and soft landings",
        make_stack=without_terms(directions_stack, DIRECTION_WEIGHTS, "power", "landing"),
    ),
    "no_path": Variant(
        "no reward for staying on the path",
        make_stack=without_terms(directions_stack, DIRECTION_WEIGHTS, "path_diff"),
    ),
    "no_heading": Variant(
        "no reward for the heading",
        make_stack=without_terms(directions_stack, DIRECTION_WEIGHTS, "heading_diff"),
    ),
    "no_symmetry": Variant("networks without mirror symmetry", {"symmetric": False}),
    "memory": Variant(
        "a recurrent policy (GRU), trained on windows of 0.24 s, also without symmetry",
        {"symmetric": False},
        networks={"make_actor": make_recurrent_actor},
    ),
    "world_frame": Variant(
        "orientation, velocity and the direction of the path in the world, in which all episodes"
        " start along x",
        make_stack=in_world_frame,
    ),
    "independent_gaits": Variant(
        "the nearest gait of the library, without interpolation", make_stack=with_independent_gaits
    ),
}
"""Name -> difference from the default."""


def experiment(config: Config, resume_command: str) -> Experiment:
    """Trainings of all variants; `resume_command` is for messages."""
    return Experiment(
        VARIANTS,
        directions_stack,
        DIRECTION_WEIGHTS,
        partial(_train, config.library, resume_command),
        _STEP_SECONDS,
        groups=("Nominal robots", "Drawn robots, floors and sensors"),
    )


def _train(
    library: str, resume_command: str, variant: Variant, settings: Mapping[str, Any]
) -> list[WalkResult]:
    """Train or resume one run; returns its walks on the nominal robot, then on drawn robots."""
    config = DirectionConfig(**settings, library=library, **variant.settings)
    make_stack = variant.make_stack or directions_stack
    ppo_directions.main(config, resume_command, make_stack=make_stack, **variant.networks)
    policy, gaits = aslip.load_policy(config.out), GaitLibrary.load(library)
    common = evaluation_stack(make_stack(gaits), gaits)
    walks = []
    for one in (common, randomise_stack(common, WIDE_RANGES)):
        env, commands = make_evaluation_env(partial(aslip.make_env, stack=one), seed=0)
        with closing(env):
            walks += evaluate(policy, env, commands, MAX_EPISODE_STEPS)
    return walks
