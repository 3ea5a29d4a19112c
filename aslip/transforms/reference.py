"""Reference motion of a gait library, feedforward, and starts on the reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Literal, cast, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary, Reference
from aslip.robot import CASSIE
from aslip.transforms.base import (
    SeededTransform,
    draw_into_reset,
    extend_spec,
    require_keys,
    reset_rows,
    spread,
)
from aslip.transforms.standing import advance_mode

_MOTORS = tuple(field.name for field in fields(Reference) if field.name.startswith("motor"))
_BODY = tuple(field.name for field in fields(Reference) if field.name not in _MOTORS)

InitialVelocity = Literal["reference", "rest"]


class ReferenceInjection(SeededTransform):
    """Write the motion of a gait library as `("reference", ...)` and `("target", ...)`.

    Both follow the current command, but differ in time:

    - reference, body and feet: at the current phase;
    - reference, motor angles, rates and torques: at the end of the coming policy step, when the PD
      loops should reach them. The paper does not name the instant; its public code does the same.
    - target, body and feet: at the end of the coming policy step.

    The policy sees the reference and is rewarded for reaching the target, even if the command
    changes during the step; so reward terms list the target in `root_keys`. While the command is
    constant, the target equals the next reference bit for bit.

    A planner may replace this transform. It must write the fields of `aslip.library.Reference`
    under both keys; the target needs no motor fields.

    Args:
        library: gaits.
        motor_lead: time by which the motor entries are ahead of the phase, in policy steps.
        in_keys: keys of command (n, c) and phase (n, 1); to stand, too, also of mode (n, 1) and of
            the stand command (n, 1), see `aslip.transforms.StandClock`.
        out_keys: keys of reference and target.

    Raises:
        ConfigurationError: `motor_lead` is not a finite number.
    """

    def __init__(
        self,
        library: GaitLibrary,
        motor_lead: float = 1.0,
        *,
        in_keys: Sequence[NestedKey] = ("command", "phase"),
        out_keys: Sequence[NestedKey] = ("reference", "target"),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.library = library
        self.motor_lead = check_number("motor_lead", motor_lead, what="in policy steps")
        if len(self.in_keys) not in (2, 4):
            raise ConfigurationError(
                "in_keys of ReferenceInjection must be those of command and phase, and perhaps of"
                f" mode and the stand command, got {self.in_keys}"
            )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        entries = [cast("Tensor", next_tensordict[key]) for key in self.in_keys]
        command, phase, *standing = entries
        found = reference_and_target(
            *(self.library, command, phase),
            motor_lead=self.motor_lead,
            standing=(standing[0], standing[1]) if standing else None,
        )
        for key, entries in zip(self.out_keys, found, strict=True):
            next_tensordict.set(key, TensorDict(entries, next_tensordict.batch_size))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL uses only the rows of reset robots, so the others are not looked up
        rows = reset_rows(tensordict)
        if rows is None:
            return self._call(tensordict_reset)
        found = self._call(tensordict_reset.select(*self.in_keys)[rows])
        for key in self.out_keys:
            group = cast("TensorDictBase", found[key])
            whole = {name: spread(entry, rows) for name, entry in group.items()}
            tensordict_reset.set(key, TensorDict(whole, tensordict_reset.batch_size))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the fields of reference and target."""
        require_keys(self, observation_spec, self.in_keys)
        command, phase = torch.zeros(self.library.command_size), torch.zeros(1)
        found = reference_and_target(self.library, command, phase, motor_lead=self.motor_lead)
        for key, entries in zip(self.out_keys, found, strict=True):
            group = Composite(shape=observation_spec.shape)
            sizes = {name: entry.shape[-1] for name, entry in entries.items()}
            observation_spec[key] = extend_spec(group, sizes)
        return observation_spec


def reference_and_target(
    library: GaitLibrary,
    command: Tensor,
    phase: Tensor,
    *,
    motor_lead: float = 1.0,
    standing: tuple[Tensor, Tensor] | None = None,
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Entries of the reference and of the target; see `ReferenceInjection`.

    Args:
        library: gaits.
        command: (*b, c) one value per axis of the library.
        phase: (*b, 1) stride fraction.
        motor_lead: time by which the motor entries are ahead of the phase, in policy steps.
        standing: mode (*b, 1) and stand command (*b, 1), of robots that stay steady until then;
            robots walk by default.
    """
    # one lookup for all instants takes half the time of two lookups
    leads = list(dict.fromkeys([0.0, 1.0, motor_lead]))
    modes = None
    if standing is None:
        stride = library.stride(command)
        phases = torch.stack([phase + lead * CASSIE.policy_period / stride for lead in leads])
    else:
        mode, stand = standing
        later = [
            advance_mode(library, phase, mode, command, stand, lead * CASSIE.policy_period)
            for lead in leads
        ]
        phases, modes = (torch.stack(part) for part in zip(*later, strict=True))
    found = library.lookup(phases, command, modes)
    motors = leads.index(motor_lead)
    reference = {name: getattr(found, name)[motors] for name in _MOTORS}
    reference |= {name: getattr(found, name)[0] for name in _BODY}
    return reference, {name: getattr(found, name)[1] for name in _BODY}


def feedforward_target(
    reference: Mapping[str, Tensor], stiffness: Tensor, damping: Tensor
) -> Tensor:
    """Targets (*b, m) [rad] with which PD loops of these gains (m,) follow the reference."""
    position, velocity, torque = (
        reference[f"motor_{name}"] for name in ("position", "velocity", "torque")
    )
    return position + (torque + damping * velocity) / stiffness


class Feedforward(SeededTransform):
    r"""Write the motor targets with which PD loops follow the reference.

    They are `("reference", "motor_target")` (n, m) [rad].

    .. math:: \hat a = \hat q + K_p^{-1} (\hat\tau + K_d \dot{\hat q})

    In the paper, the targets are the reference's motor angles. With these the legs lag 0.1 s
    behind, since the loops' velocity target is zero, and the knee yields by 0.7 rad under the
    robot's weight. A policy would first have to learn to correct both. The torques
    :math:`\hat\tau` come from the leg forces of the reduced-order model.

    K_p and K_d are the gains of `Robot.stiffness` and `Robot.damping`.
    """

    @on_cpu_in_single
    def __init__(self) -> None:
        super().__init__(in_keys=["reference"], out_keys=[("reference", "motor_target")])
        self._stiffness, self._damping = (
            torch.tensor(gain, dtype=torch.float32) for gain in (CASSIE.stiffness, CASSIE.damping)
        )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reference = cast("Mapping[str, Tensor]", next_tensordict[self.in_keys[0]])
        target = feedforward_target(reference, self._stiffness, self._damping)
        return next_tensordict.set(self.out_keys[0], target)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the target."""
        group = unravel_key((self.in_keys[0], "motor_torque"))
        require_keys(self, observation_spec, [group])
        return extend_spec(observation_spec, {self.out_keys[0]: observation_spec[group].shape[-1]})


class ReferenceDistance(SeededTransform):
    """Write the distance (n, 1) that the reference has walked since the reset [m].

    `("reference", "distance")` is that of now, `("target", "distance")` that at the end of the
    coming policy step.

    The x of the reference is its deviation from uniform motion; the distance plus this x is its
    position in the world. Must come after `ReferenceInjection`, which replaces the groups
    `reference` and `target`.
    """

    def __init__(self) -> None:
        super().__init__(["command"], [("reference", "distance"), ("target", "distance")])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        command = cast("Tensor", tensordict_reset[self.in_keys[0]])
        return self._written(tensordict_reset, torch.zeros_like(command))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        distance, command = (tensordict[key] for key in (self.out_keys[0], self.in_keys[0]))
        return self._written(next_tensordict, distance + CASSIE.policy_period * command)

    def _written(self, into: TensorDictBase, distance: Tensor) -> TensorDictBase:
        now, following = self.out_keys
        into.set(following, distance + CASSIE.policy_period * into[self.in_keys[0]])
        return into.set(now, distance)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the distances.

        Raises:
            UnknownNameError: no transform before this one writes their group.
        """
        require_keys(self, observation_spec, self.in_keys)
        for group in (key[0] for key in self.out_keys if isinstance(key, tuple)):
            if group not in observation_spec.keys():  # noqa: SIM118, of a spec
                raise UnknownNameError(
                    f"ReferenceDistance adds to {group!r}, which nothing before it in the stack"
                    " writes"
                )
        return extend_spec(observation_spec, dict.fromkeys(self.out_keys, 1))


class ReferenceStart(SeededTransform):
    """Start each episode on the reference, at the drawn phase and command.

    To start elsewhere, pass `("initial", "qpos")`, `("initial", "qvel")` or both to `env.reset`.
    A partial reset (with a `_reset` mask) always starts the reset robots on the reference.

    Must come before `RandomCommand` and `PhaseClock` in the stack: TorchRL prepares resets from the
    last transform to the first.

    Paper: the robot "is set to a random starting position in the trajectory's walk cycle", without
    a word on its velocity. The public code intends a start at rest. Our episodes start with the
    reference's velocities: a start at rest may favour standing still, which was not compared.

    Args:
        library: gaits.
        velocity: "reference", or "rest" as in the public code.
        in_keys: keys of command (n, c) and phase (n, 1), and perhaps of mode (n, 1).

    Raises:
        ConfigurationError: `velocity` is neither.
    """

    needs_env = "it places robots at resets"

    def __init__(
        self,
        library: GaitLibrary,
        velocity: InitialVelocity = "reference",
        *,
        in_keys: Sequence[NestedKey] = ("command", "phase"),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=[])
        if velocity not in get_args(InitialVelocity):
            raise ConfigurationError(
                f"velocity must be one of {get_args(InitialVelocity)}, got {velocity!r}"
            )
        self.library = library
        self.velocity = velocity

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None or any(tensordict.get(key, None) is None for key in self.in_keys):
            raise ConfigurationError(
                f"ReferenceStart found no {' and '.join(map(str, self.in_keys))}: put it before"
                " SpeedCommand and PhaseClock in the stack; transforms that replace these must"
                " write the entries in `_reset_env_preprocess`"
            )
        command, phase, *mode = (cast("Tensor", tensordict[key]) for key in self.in_keys)
        rows = reset_rows(tensordict)
        if rows is None:
            qpos, qvel = self.library.initial_state(phase, command, *mode)
        else:
            at = (entry[rows] for entry in (phase, command, *mode))
            qpos, qvel = (spread(part, rows) for part in self.library.initial_state(*at))
        if self.velocity == "rest":
            qvel = torch.zeros_like(qvel)
        draw_into_reset(tensordict, ("initial", "qpos"), qpos)
        draw_into_reset(tensordict, ("initial", "qvel"), qvel)
        return tensordict
