"""Train without each part of the method, several seeds, and compare in one table and one picture.

    python recipes/ablate.py                                        # all variants, three seeds
    python recipes/ablate.py --variants default no_delta --seeds 0 1 --total-steps 500000
    python recipes/ablate.py --list

Variants are trained one after the other with the same budget. Finished work is kept: the same
command resumes an interrupted training and adds new rows to the table. All policies are evaluated
on the same task (`aslip.envs.evaluation_stack`): walks at 21 speeds, with the paper's reward on the
true state and the motion of the actuated spring-mass model. Each policy gets the observation with
which it was trained.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ablate_settings import AblationConfig

from aslip.base.command_line import command_line, this_command
from aslip.errors import one_line_errors

NAMES = (
    "default", "no_com_vel", "no_foot_pos", "no_straight_diff", "no_foot_orient", "no_action_diff",
    "no_delta", "no_feedforward", "no_symmetry", "no_model_inputs", "pendulum", "truth",
    "reward_on_estimate", "no_delay", "no_reflected_inertia",
)  # fmt: skip
"""Names of the variants."""


@dataclass(frozen=True)
class Config(AblationConfig):
    """Settings of the ablations."""

    names: ClassVar[tuple[str, ...]] = NAMES
    variants: tuple[str, ...] = NAMES
    """Names of the variants to train."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import field, replace
from functools import partial
from typing import Any

import ppo_aslip
import torch
from ablation import NEVER, Experiment, Found, is_begun, run
from ppo_settings import PRESETS
from tensordict import TensorDictBase
from torchrl.data import Composite

import aslip
from aslip.envs import (
    MAX_EPISODE_STEPS,
    ON_TRUTH,
    STACKS,
    Stack,
    command_speeds,
    default_stack,
    edit_stack,
    evaluation_stack,
    insert_before,
)
from aslip.library import pendulum_library
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.transforms import (
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    ClockInput,
    RandomDynamics,
    SeededTransform,
    WeightedReward,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import WalkResult, evaluate

_RESULTS = "judged.json"
_NEVER = 10**12  # policy steps; evaluations would take a tenth of such a short training
_TIMED_STEPS, _UPDATES_TOO = 4, 1.2  # of an estimated duration: policy steps, factor for updates


class StandingBaseline(SeededTransform):
    """Write the motor angles of the standing robot under `("baseline", "motor_position")`."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[("baseline", "motor_position")])
        model = load_model()
        motors = CASSIE.indices.motor_qpos
        self._angles = torch.tensor(model.key("standing").qpos[motors], dtype=torch.float32)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        angles = self._angles.expand(*next_tensordict.batch_size, -1)
        return next_tensordict.set(self.out_keys[0], angles.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the angles."""
        return extend_spec(observation_spec, {self.out_keys[0]: len(CASSIE.motor_names)})


@dataclass(frozen=True)
class Variant:
    """One experiment."""

    question: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of `ppo_aslip.py` that differ from the default."""
    edits: Callable[[], dict[str, Any]] = dict
    """Function that makes the arguments of `aslip.make_env` that differ from the default."""


def without_term(name: str) -> Variant:
    """Variant without a reward term; the others share its weight, so the largest reward is 1."""
    rest = 1 - PAPER_WEIGHTS[name]
    weights = {key: 0.0 if key == name else w / rest for key, w in PAPER_WEIGHTS.items()}
    replaced = {"reward": WeightedReward(weights)}
    return Variant(f"no reward for {name}", edits=lambda: {"replace": replaced})


def with_dynamics(name: str, value: float) -> Callable[[], dict[str, Any]]:
    """Function that makes the edits for robots with other dynamics."""

    def edits() -> dict[str, Any]:
        dynamics = RandomDynamics({name: (value, value)})
        return {"stack": insert_before(default_stack(), "start", dynamics=dynamics)}

    return edits


def _absolute_actions() -> dict[str, Any]:
    stack = insert_before(default_stack(), "action", standing=StandingBaseline())
    stack["action"] = ActionDelta(("baseline", "motor_position"))
    return {"stack": stack}


def _blind_to_the_model() -> dict[str, Any]:
    stack = insert_before(default_stack(), "observation", clock_input=ClockInput())
    stack["observation"] = AssembleObservation(SINGLE_REFERENCE_TABLE)
    return {"stack": stack}


VARIANTS: Mapping[str, Variant] = {
    "default": Variant("everything"),
    **{f"no_{name}": without_term(name) for name in PAPER_WEIGHTS},
    "no_delta": Variant(
        "actions are added to a standing pose, not to the reference", edits=_absolute_actions
    ),
    "no_feedforward": Variant("motor targets as in the paper", edits=lambda: {"stack": "paper"}),
    "no_symmetry": Variant("no left-right symmetry of the networks", {"symmetric": False}),
    "no_model_inputs": Variant(
        "clock and speed as inputs instead of the reduced-order model", edits=_blind_to_the_model
    ),
    "pendulum": Variant(
        "linear inverted pendulum instead of the actuated spring-mass model",
        edits=lambda: {"library": pendulum_library(aslip.GaitLibrary.load().gaits)},
    ),
    "truth": Variant("the true state instead of the estimate", edits=lambda: dict(ON_TRUTH)),
    "reward_on_estimate": Variant(
        "rewards of the estimated state", edits=lambda: {"reward_on": "estimate"}
    ),
    "no_delay": Variant("no torque delay", edits=with_dynamics("torque_delay", 0.0)),
    "no_reflected_inertia": Variant(
        "no reflected inertia of the motors", edits=with_dynamics("reflected_inertia", 0.0)
    ),
}
"""Name -> difference from the default."""


def main(config: Config, go_on: str = "the same call") -> Found:
    """Train missing variants, then write table and picture; returns the walks.

    Args:
        config: the settings.
        go_on: command that continues after an interruption, for messages.
    """
    experiment = Experiment(
        questions={name: variant.question for name, variant in VARIANTS.items()},
        weights=PAPER_WEIGHTS,
        train=partial(train, config, go_on=go_on),
        seconds=partial(estimated_seconds, config),
    )
    return run(config, experiment)


def estimated_seconds(config: Config) -> float:
    """Duration of a training and two evaluations, extrapolated from a few policy steps [s]."""
    env = aslip.make_env(num_envs=config.num_envs, seed=0)
    env.rollout(1)
    start = time.perf_counter()
    env.rollout(_TIMED_STEPS, break_when_any_done=False)
    seconds = (time.perf_counter() - start) / (_TIMED_STEPS * config.num_envs)
    speeds = len(command_speeds(env))
    env.close()
    return seconds * (_UPDATES_TOO * config.total_steps + 2 * speeds * MAX_EPISODE_STEPS)


def trained_on(variant: Variant) -> Stack:
    """Stack on which the policies of a variant are trained."""
    edits = {"stack": "default", **variant.edits()}
    stack = edits["stack"]
    if isinstance(stack, str):
        stack = STACKS[stack](edits.get("library"), edits.get("reward_on", "truth"))
    return edit_stack(stack, edits.get("drop", ()), edits.get("replace", {}))


def judge(folder: Path, variant: Variant, seed: int) -> list[WalkResult]:
    """Walks of a training's policy at all speeds, on the common task of evaluations."""
    speeds = aslip.GaitLibrary.load().speeds.tolist()
    stack = evaluation_stack(trained_on(variant))
    with closing(aslip.make_env(num_envs=len(speeds), seed=seed, stack=stack)) as env:
        return evaluate(aslip.load_policy(folder), env, speeds, PRESETS["default"].eval_steps)


def train(config: Config, name: str, folder: Path, seed: int, go_on: str) -> list[WalkResult]:
    """Train or resume one run, and return its walks."""
    variant, resume = VARIANTS[name], is_begun(folder, config)
    settings = replace(
        PRESETS["default"], out=folder, seed=seed, total_steps=config.total_steps,
        num_envs=config.num_envs, eval_interval=NEVER, resume=resume, **variant.settings,
    )  # fmt: skip
    make_env = partial(aslip.make_env, **variant.edits())
    ppo_aslip.main(settings, make_env, go_on=go_on)
    return judge(folder, variant, seed)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, go_on=this_command())
