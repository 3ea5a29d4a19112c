"""Train walks in all directions without each part of the method, and compare them.

    python recipes/ablate_directions.py                             # all variants, one seed each
    python recipes/ablate_directions.py --variants default no_effort --seeds 0 1 2 3 4
    python recipes/ablate_directions.py --list

Works like `ablate.py`: variants have the same budget, finished work is kept, and the same command
goes on. All policies walk the same 32 commands of the shipped library twice: on the nominal robot,
and on robots, floors and sensors drawn from `aslip.transforms.WIDE_RANGES`, which are the same for
each policy. Each has a table. Policies are compared by the reward of
`aslip.transforms.rewards.DIRECTION_WEIGHTS`, to the gaits of the shipped library; a walk whose
reward falls below the limit of trainings does not survive. These walks hold one command, and
nothing pushes them: what a variant does to sudden changes, pushes and standing shows in the
episodes of its training only, of which the picture has the lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ablate_settings import AblationConfig

from aslip.base.command_line import command_line, this_command
from aslip.errors import one_line_errors

NAMES = (
    "default", "no_randomise", "no_pushes", "no_privileged", "no_curriculum", "no_effort",
    "no_path", "no_heading", "no_symmetry", "memory", "world_frame", "independent_gaits",
    "no_minimum_force",
)  # fmt: skip
"""Names of the variants."""


@dataclass(frozen=True)
class Config(AblationConfig):
    """Settings of the ablations."""

    names: ClassVar[tuple[str, ...]] = NAMES
    variants: tuple[str, ...] = NAMES
    """Names of the variants to train."""
    seeds: tuple[int, ...] = (0,)
    """Seeds of each variant."""
    total_steps: int = 1_200_000
    """Policy steps of each training."""
    out: Path = Path("runs/direction_ablation")
    """Folder of all trainings, the table `ablation.md` and the picture `ablation.png`."""
    library: str = "directions"
    """Library of gaits: the shipped one, or a file."""
    unloaded: Path = Path("runs/unloaded/gaits.npz")
    """Library of the variant `no_minimum_force`, from `python recipes/direction_library.py --out
    runs/unloaded --model.min-stance-force 0`, with the grid and limits of `library`."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import field
from functools import partial
from typing import Any

import ppo_directions
import torch
from ablation import NEVER, Experiment, Found, is_begun, run
from ppo_directions import DirectionConfig
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite

import aslip
from aslip.envs import (
    MAX_EPISODE_STEPS,
    Stack,
    evaluation_stack,
    insert_before,
    randomise_stack,
    standing_stack,
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
    WeightedReward,
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

MakeStack = Callable[[GaitLibrary], Stack]
"""Function from a library to the stack of a policy, without what only training has."""

_SECONDS_A_STEP = 1.2e-3  # of one core, about


class WorldFrame(SeededTransform):
    """Write the estimated orientation and velocity in a frame that does not turn with the path.

    Entries are `("world", "orientation")` (n, 4), wxyz with w >= 0, `("world", "velocity")` (n, 3)
    [m/s], and the way of the path there, the unit vector `("world", "direction")` (n, 2).
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
    """Stack whose policy observes orientation, velocity and the way of the path in the world."""
    moved: Mapping[NestedKey, NestedKey] = {
        ("estimate", name): ("world", name) for name in ("orientation", "velocity")
    }
    table = [*(moved.get(key, key) for key in DIRECTION_TABLE), ("world", "direction")]
    stack = insert_before(standing_stack(library), "observation", world=WorldFrame())
    return {**stack, "observation": AssembleObservation(table)}


def with_independent_gaits(library: GaitLibrary) -> Stack:
    """Stack whose reference is always a gait of the library, and jumps between them."""
    stack = insert_before(standing_stack(library), "clock", nearest_gait=NearestGait(library))
    stack["clock"] = StandClock(library, "gait_command")
    keys: list[NestedKey] = ["gait_command", "phase", "mode", "stand"]
    stack["reference"] = ReferenceInjection(library, in_keys=keys)
    return stack


def without_terms(library: GaitLibrary, names: Sequence[str]) -> Stack:
    """Stack without some reward terms; the weights of the others are scaled to a sum of 1."""
    rest = 1 - sum(DIRECTION_WEIGHTS[name] for name in names)
    weights = {k: 0.0 if k in names else w / rest for k, w in DIRECTION_WEIGHTS.items()}
    return {**standing_stack(library), "reward": WeightedReward(weights)}


@dataclass(frozen=True)
class Variant:
    """One experiment."""

    question: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of `ppo_directions.py` that differ from the default."""
    make_stack: MakeStack = standing_stack
    """Function that makes the stack."""
    networks: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of `ppo_directions.main` for other networks."""


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
        make_stack=partial(without_terms, names=("power", "landing")),
    ),
    "no_path": Variant(
        "no reward for staying on the path", make_stack=partial(without_terms, names=("path_diff",))
    ),
    "no_heading": Variant(
        "no reward for the heading", make_stack=partial(without_terms, names=("heading_diff",))
    ),
    "no_symmetry": Variant("networks without mirror symmetry", {"symmetric": False}),
    "memory": Variant(
        "a recurrent policy (GRU), trained on windows of 0.24 s, also without symmetry",
        {"symmetric": False},
        networks={"make_actor": make_recurrent_actor},
    ),
    "world_frame": Variant(
        "orientation, velocity and the way of the path in the world, in which all episodes start"
        " along x",
        make_stack=in_world_frame,
    ),
    "independent_gaits": Variant(
        "the nearest gait of the library, without interpolation", make_stack=with_independent_gaits
    ),
    "no_minimum_force": Variant("gaits that may let go of the floor in mid-stance"),
}
"""Name -> difference from the default."""


def main(config: Config, go_on: str = "the same call") -> Found:
    """Train missing variants, then write table and picture; returns the walks.

    Args:
        config: the settings.
        go_on: command that continues after an interruption, for messages.
    """
    origins = {}
    if not config.list:
        # loaded at once, as a missing file would end the work after hours
        files = {config.library, *(library_of(config, name) for name in config.variants)}
        origins = {file: GaitLibrary.load(file).sha256 for file in files}
    experiment = Experiment(
        questions={name: variant.question for name, variant in VARIANTS.items()},
        weights=DIRECTION_WEIGHTS,
        train=partial(train, config, go_on=go_on),
        seconds=lambda: _SECONDS_A_STEP * config.total_steps,
        origin=lambda name: {
            "trained on": origins[library_of(config, name)],
            "compared with": origins[config.library],
        },
        groups=("Nominal robots", "Drawn robots, floors and sensors"),
    )
    return run(config, experiment)


def train(config: Config, name: str, folder: Path, seed: int, go_on: str) -> list[WalkResult]:
    """Train or resume one run, and return its walks."""
    variant, resume = VARIANTS[name], is_begun(folder, config)
    library = library_of(config, name)
    settings = DirectionConfig(
        out=folder,
        seed=seed,
        total_steps=config.total_steps,
        num_envs=config.num_envs,
        eval_interval=NEVER,
        resume=resume,
        **{"library": library, **variant.settings},
    )
    ppo_directions.main(settings, go_on, make_stack=variant.make_stack, **variant.networks)
    stack = variant.make_stack(GaitLibrary.load(library))
    return judge(folder, stack, GaitLibrary.load(config.library))


def library_of(config: Config, name: str) -> str:
    """Library that a variant is trained on."""
    return str(config.unloaded) if name == "no_minimum_force" else config.library


def judge(folder: Path, stack: Stack, library: GaitLibrary) -> list[WalkResult]:
    """Walks of a training's policy on the nominal robot, then on drawn robots.

    Args:
        folder: folder of the training.
        stack: stack of its policy.
        library: gaits of the common task.
    """
    policy, common = aslip.load_policy(folder), evaluation_stack(stack, library)
    walks = []
    for one in (common, randomise_stack(common, WIDE_RANGES)):
        env, commands = make_evaluation_env(partial(aslip.make_env, stack=one), seed=0)
        with closing(env):
            walks += evaluate(policy, env, commands, MAX_EPISODE_STEPS)
    return walks


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, go_on=this_command())
