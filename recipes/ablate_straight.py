"""Ablations of straight walks: each part of the method."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import ppo_aslip
import torch
from ablate_settings import Config
from ablation import Experiment, MakeStack, Variant, without_terms
from ppo_settings import PRESETS
from tensordict import TensorDictBase
from torchrl.data import Composite

import aslip
from aslip.envs import (
    ON_TRUTH,
    Stack,
    default_stack,
    edit_stack,
    evaluation_stack,
    insert_before,
    paper_stack,
)
from aslip.library import GaitLibrary, pendulum_library
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.transforms import (
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    ClockInput,
    RandomDynamics,
    SeededTransform,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import WalkResult, evaluate

_STEP_SECONDS = 1.4e-3  # of one core


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


def with_dynamics(name: str, value: float) -> MakeStack:
    """Stack for robots with other dynamics."""
    dynamics = RandomDynamics({name: (value, value)})
    return lambda library: insert_before(default_stack(library), "start", dynamics=dynamics)


def with_absolute_actions(library: GaitLibrary) -> Stack:
    """Stack whose actions are added to the standing pose."""
    stack = insert_before(default_stack(library), "action", standing=StandingBaseline())
    return {**stack, "action": ActionDelta(("baseline", "motor_position"))}


def blind_to_the_model(library: GaitLibrary) -> Stack:
    """Stack whose policy observes clock and speed in place of the model's motion."""
    stack = insert_before(default_stack(library), "observation", clock_input=ClockInput())
    return {**stack, "observation": AssembleObservation(SINGLE_REFERENCE_TABLE)}


VARIANTS: Mapping[str, Variant] = {
    "default": Variant("everything"),
    **{
        f"no_{name}": Variant(
            f"no reward for {name}", make_stack=without_terms(default_stack, PAPER_WEIGHTS, name)
        )
        for name in PAPER_WEIGHTS
    },
    "no_delta": Variant(
        "actions are added to a standing pose, not to the reference",
        make_stack=with_absolute_actions,
    ),
    "no_feedforward": Variant("motor targets as in the paper", make_stack=paper_stack),
    "no_symmetry": Variant("no left-right symmetry of the networks", {"symmetric": False}),
    "no_model_inputs": Variant(
        "clock and speed as inputs instead of the reduced-order model",
        make_stack=blind_to_the_model,
    ),
    "pendulum": Variant(
        "linear inverted pendulum instead of the actuated spring-mass model",
        make_stack=lambda library: default_stack(pendulum_library(library.gaits)),
    ),
    "truth": Variant(
        "the true state instead of the estimate",
        make_stack=lambda library: edit_stack(default_stack(library), **ON_TRUTH),
    ),
    "reward_on_estimate": Variant(
        "rewards of the estimated state",
        make_stack=lambda library: default_stack(library, "estimate"),
    ),
    "no_delay": Variant("no torque delay", make_stack=with_dynamics("torque_delay", 0.0)),
    "no_reflected_inertia": Variant(
        "no reflected inertia of the motors", make_stack=with_dynamics("reflected_inertia", 0.0)
    ),
}
"""Name -> difference from the default."""


def experiment(config: Config, resume_command: str) -> Experiment:
    """Trainings of all variants; `resume_command` is for messages."""
    train = partial(_train, config.library, resume_command)
    return Experiment(VARIANTS, default_stack, PAPER_WEIGHTS, train, _STEP_SECONDS)


def _train(
    library: str, resume_command: str, variant: Variant, settings: Mapping[str, Any]
) -> list[WalkResult]:
    """Train or resume one run; returns its walks at all speeds, on the task of evaluations."""
    config = replace(PRESETS["default"], library=library, **settings, **variant.settings)
    gaits = GaitLibrary.load(library)
    stack = (variant.make_stack or default_stack)(gaits)
    ppo_aslip.main(config, partial(aslip.make_env, stack=stack), resume_hint=resume_command)
    speeds, common = gaits.speeds.tolist(), evaluation_stack(stack, gaits)
    with closing(aslip.make_env(num_envs=len(speeds), seed=config.seed, stack=common)) as env:
        return evaluate(aslip.load_policy(config.out), env, speeds, config.eval_steps)
