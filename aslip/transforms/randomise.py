"""Domain randomisation: dynamics and sensor noise drawn for each episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from aslip.base.checks import check_number
from aslip.errors import ConfigurationError
from aslip.sim import DYNAMICS
from aslip.sim.parameters import parameter_named
from aslip.transforms.base import ChosenAtReset
from aslip.transforms.curriculum import difficulty_of

DYNAMICS_RANGES: Final = MappingProxyType(
    {
        # one factor for all bodies; the robot's weight has the same standard deviation as with
        # `apex`, which draws a factor from 0.5 to 1.5 for each body
        "mass": (0.8, 1.2),
        # as in `apex`
        "floor_friction": (0.4, 1.1),
        # `apex` draws 0.3 to 5.0, for each joint
        "joint_damping": (0.5, 3.0),
        # as in another public environment of Cassie
        "spring_stiffness": (0.8, 1.2),
        # 1.7 degrees, as in both
        "slope": (-0.03, 0.03),
        # ours; the other environment draws the gains of the PD loop from 0.7 to 1.3
        "motor_strength": (0.8, 1.2),
        # ours, up to twice the robot's 3 ms
        "torque_delay": (0.001, 0.006),
        # ours
        "sensor_noise": (0.5, 1.5),
    }
)
"""Parameter of `aslip.sim.DYNAMICS` -> least and greatest value, for policies meant for hardware.

`apex` is the public code of Siekmann et al. 2020 and 2021, on which the paper's code is based. Xie
et al. 2019 transferred policies to Cassie without domain randomisation."""

WIDE_RANGES: Final = MappingProxyType(
    {
        **DYNAMICS_RANGES,
        "floor_friction": (0.4, 1.2),
        "payload": (0.0, 16.0),
        # 9 degrees
        "slope": (-0.157, 0.157),
        # from 4 ms on, the PD loops of the feet oscillate by themselves
        "torque_delay": (0.0, 0.006),
        "motor_strength": (0.7, 1.4),
        "reflected_inertia": (0.8, 1.2),
        "pd_stiffness": (0.9, 1.1),
        "pd_damping": (0.9, 1.1),
    }
)
"""Ranges for walks in all directions: those of `DYNAMICS_RANGES`, widened to loads, slopes, floors,
delays and motors on which policies in all directions are to walk."""

# drawn from a copy of the generator, so that they do not change the draws of the others
_GAINS = ("pd_stiffness", "pd_damping")


class RandomDynamics(ChosenAtReset):
    """Draw parameters of each robot's dynamics at each of its resets, uniformly within ranges.

    Writes them as `("dynamics", name)` (n, 1) in single precision at resets and steps, for logs and
    for critics with privileged input. The draws of a parameter do not depend on the ranges of
    others. Parameters without a range keep the environment's values.

    To choose a value, pass `("dynamics", name)` to `env.reset`; the parameter needs no range. A
    partial reset (with a `_reset` mask) draws new values for the reset robots only.

    With the difficulty of a `Difficulty` later in the stack, ranges grow from the nominal value to
    their full width.

    No stack has it by default; `aslip.envs.randomise_stack` adds it.

    Args:
        ranges: parameter -> least and greatest value.
        share: probability with which a parameter is drawn; else it is nominal. With many
            parameters, a small share keeps robots that are extreme in all of them rare, and robots
            that are nominal in most of them frequent.
        difficulty_key: key of the difficulty (n, 1).

    Raises:
        UnknownNameError: there is no such parameter.
        ConfigurationError: `ranges` is not a mapping, or a range is not two numbers within the
            limits of the parameter; or `share` is not from 0 to 1.
    """

    needs_env = "it draws parameters at resets"

    def __init__(
        self,
        ranges: Mapping[str, tuple[float, float]] = DYNAMICS_RANGES,
        *,
        share: float = 1.0,
        difficulty_key: NestedKey | None = None,
    ) -> None:
        if not isinstance(ranges, Mapping):
            raise ConfigurationError(f"ranges must map parameters to (low, high), got {ranges!r}")
        for name, pair in ranges.items():
            parameter = parameter_named(name)
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise ConfigurationError(f"the range of {name!r} must be (low, high), got {pair!r}")
            low, high = (
                check_number(f"a limit of {name!r}", value, parameter.low, parameter.high)
                for value in pair
            )
            if low > high:
                raise ConfigurationError(f"the range of {name!r} must be (low, high), got {pair!r}")
        super().__init__(
            [] if difficulty_key is None else [difficulty_key],
            {("dynamics", name): 1 for name in ranges},
        )
        self.difficulty_key = difficulty_key
        self.ranges = dict(ranges)
        self.share = check_number("share", share, 0, 1)

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        # a column for every parameter, also for those that are not drawn
        aside = _aside(self.generator)
        others = [name for name in DYNAMICS if name not in _GAINS]
        columns = _draw(request.batch_size, others, self.generator)
        columns |= _draw(request.batch_size, _GAINS, aside)
        chances = _draw(request.batch_size, [*DYNAMICS], aside)
        difficulty = difficulty_of(request, self.difficulty_key)
        drawn: dict[NestedKey, Tensor] = {}
        for name, (low, high) in self.ranges.items():
            draw = (low + (high - low) * columns[name]).clamp(low, high)
            nominal = DYNAMICS[name].nominal
            if self.difficulty_key is not None:
                draw = nominal + difficulty * (draw - nominal)
            drawn["dynamics", name] = torch.where(chances[name] < self.share, draw, nominal)
        return drawn

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        return self._step(request, request)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.out_keys:
            next_tensordict.set(key, cast("Tensor", tensordict[key]).float())
        return next_tensordict


def _draw(shape: torch.Size, names: Sequence[str], generator: torch.Generator) -> dict[str, Tensor]:
    """Column of uniform random numbers from 0 to 1 for each name."""
    numbers = torch.rand((*shape, len(names)), generator=generator, dtype=torch.float32)
    return dict(zip(names, numbers.split(1, dim=-1), strict=True))


def _aside(generator: torch.Generator) -> torch.Generator:
    """Generator seeded by the state of another generator, which does not change."""
    seed = torch.randint(2**62, (), generator=generator.clone_state())
    return torch.Generator(generator.device).manual_seed(int(seed))
