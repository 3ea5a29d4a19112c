"""Where gaits and robot meet: the reference motion, and starting on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Literal, cast, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary, Reference
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, check_number, extend_spec, require_keys

_MOTORS = tuple(field.name for field in fields(Reference) if field.name.startswith("motor"))
_BODY = tuple(field.name for field in fields(Reference) if field.name not in _MOTORS)
_GOAL_DISTANCE = ("goal", "distance")

InitialVelocity = Literal["reference", "rest"]


class ReferenceInjection(SeededTransform):
    """Write the library's motion under `("reference", ...)` and `("goal", ...)`.

    Both are of the present command. Body and feet under "reference" are those of the present phase.
    Motor angles, rates and torques are those of the end of the coming policy step, where the PD
    loops are to arrive; the paper does not say which instant it means, and its public code does the
    same.

    Body and feet under "goal" are those of the end of the coming policy step, too: a policy that
    sees the reference is rewarded for reaching the goal, whatever is commanded in the meantime.
    Reward terms therefore read the goal among their `root_keys`. While the command is constant the
    goal is the next reference, bit for bit.

    Args:
        library: the gaits.
        motor_lead: how far ahead the motors are read, in policy steps.
        reference_key: another key in place of "reference".
        goal_key: another key in place of "goal".

    Raises:
        ConfigurationError: `motor_lead` is no finite number.
    """

    def __init__(
        self,
        library: GaitLibrary,
        motor_lead: float = 1.0,
        *,
        reference_key: str = "reference",
        goal_key: str = "goal",
    ) -> None:
        super().__init__(in_keys=["command", "phase"], out_keys=[reference_key, goal_key])
        self.library = library
        self.motor_lead = check_number("motor_lead", motor_lead, what="in policy steps")

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        command, phase = next_tensordict["command"], next_tensordict["phase"]
        found = reference_and_goal(self.library, command, phase, motor_lead=self.motor_lead)
        for key, entries in zip(self.out_keys, found, strict=True):
            next_tensordict.set(key, TensorDict(entries, next_tensordict.batch_size))
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the fields of `aslip.library.Reference`, and of the goal."""
        require_keys(self, observation_spec, ["command", "phase"])
        sizes: dict[NestedKey, int] = {
            (group, name): 3 for group in self.out_keys for name in _BODY
        }
        sizes |= {(self.out_keys[0], name): len(CASSIE.motor_names) for name in _MOTORS}
        return extend_spec(observation_spec, sizes)


def reference_and_goal(
    library: GaitLibrary,
    command: Tensor,
    phase: Tensor,
    *,
    motor_lead: float = 1.0,
    period: float = CASSIE.policy_period,
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Entries of the reference and of the goal; see `ReferenceInjection`.

    Args:
        library: the gaits.
        command: (*b, 1) forward speed [m/s].
        phase: (*b, 1) stride fraction.
        motor_lead: how far ahead the motors are read, in policy steps.
        period: duration of a policy step [s].
    """
    stride = library.stride(command)
    # one lookup for all instants costs half of two
    leads = list(dict.fromkeys([0.0, 1.0, motor_lead]))
    phases = torch.stack([phase + lead * period / stride for lead in leads])
    found = library.lookup(phases, command.expand_as(phases))
    motors = leads.index(motor_lead)
    reference = {name: getattr(found, name)[motors] for name in _MOTORS}
    reference |= {name: getattr(found, name)[0] for name in _BODY}
    return reference, {name: getattr(found, name)[1] for name in _BODY}


def feedforward_target(
    reference: Mapping[str, Tensor], stiffness: Tensor, damping: Tensor
) -> Tensor:
    """Angles (*b, m) to aim PD loops of these gains (m,) at, to follow a reference [rad]."""
    position, velocity, torque = (
        reference[f"motor_{name}"] for name in ("position", "velocity", "torque")
    )
    return position + (torque + damping * velocity) / stiffness


class Feedforward(SeededTransform):
    r"""Write where PD loops must aim to follow the reference, ("reference", "motor_target").

    .. math:: \hat a = \hat q + K_p^{-1} (\hat\tau + K_d \dot{\hat q})

    The loops' velocity target is zero and their stiffness finite: aimed at the reference's angles,
    as in the paper, they lag 0.1 s behind and give way by 0.7 rad at the knee under the robot's
    weight, which a policy first has to learn. The reduced-order model knows the load of each leg.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["reference"], out_keys=[("reference", "motor_target")])
        self._stiffness = torch.from_numpy(CASSIE.stiffness.copy()).float()
        self._damping = torch.from_numpy(CASSIE.damping.copy()).float()

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reference = cast("Mapping[str, Tensor]", next_tensordict["reference"])
        target = feedforward_target(reference, self._stiffness, self._damping)
        return next_tensordict.set(self.out_keys[0], target)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the target."""
        require_keys(self, observation_spec, [("reference", "motor_torque")])
        return extend_spec(observation_spec, {self.out_keys[0]: len(CASSIE.motor_names)})


class ReferenceDistance(SeededTransform):
    """Write how far the reference has gone since the reset under `("reference", "distance")` [m].

    The reference's own x is the deviation from uniform motion; added to this it is a place in the
    world. `("goal", "distance")` is the distance at the end of the coming policy step. Must come
    after `ReferenceInjection`.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["command"], out_keys=[("reference", "distance"), _GOAL_DISTANCE])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return self._written(tensordict_reset, torch.zeros_like(tensordict_reset["command"]))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        before = tensordict[self.out_keys[0]]
        return self._written(next_tensordict, before + CASSIE.policy_period * tensordict["command"])

    def _written(self, into: TensorDictBase, distance: Tensor) -> TensorDictBase:
        into.set(_GOAL_DISTANCE, distance + CASSIE.policy_period * into["command"])
        return into.set(self.out_keys[0], distance)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the distances."""
        require_keys(self, observation_spec, ["command", ("reference", "body_position")])
        return extend_spec(observation_spec, dict.fromkeys(self.out_keys, 1))


class ReferenceStart(SeededTransform):
    """Start each episode on the reference, at the drawn phase and command.

    To start elsewhere, pass `("initial", "qpos")`, `("initial", "qvel")` or both to `env.reset`;
    what is not given is the reference's. In a reset of some robots only, with a `_reset` mask, all
    is the reference's.

    Must come before `SpeedCommand` and `PhaseClock` in the stack: TorchRL prepares resets from the
    last transform to the first.

    Paper: the robot "is set to a random starting position in the trajectory's walk cycle"; of its
    velocity it says nothing. Public code means to start at rest. Started at rest the policy learns
    to stand still, so we start with the velocities that belong to the position.

    Args:
        library: the gaits.
        velocity: "reference", or "rest" as in the public code.

    Raises:
        ConfigurationError: `velocity` is neither.
    """

    def __init__(self, library: GaitLibrary, velocity: InitialVelocity = "reference") -> None:
        super().__init__(in_keys=[], out_keys=[])
        if velocity not in get_args(InitialVelocity):
            raise ConfigurationError(
                f"velocity must be one of {get_args(InitialVelocity)}, got {velocity!r}"
            )
        self.library = library
        self.velocity = velocity

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None or not {"phase", "command"} <= set(tensordict.keys()):
            raise ConfigurationError(
                "ReferenceStart found no phase and command: it must stand before SpeedCommand and"
                " PhaseClock in the stack, and what takes their place must write them in"
                " `_reset_env_preprocess`, as they do"
            )
        qpos, qvel = self.library.initial_state(tensordict["phase"], tensordict["command"])
        if self.velocity == "rest":
            qvel = torch.zeros_like(qvel)
        tensordict = self._draw_into_reset(tensordict, ("initial", "qpos"), qpos)
        return self._draw_into_reset(tensordict, ("initial", "qvel"), qvel)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return tensordict_reset

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict
