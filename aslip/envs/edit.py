"""Edits of stacks: insert, drop and replace transforms, and randomise robots.

A stack is an ordered dict, name -> transform, and may be edited like any dict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from torchrl.envs.transforms import Transform

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.transforms import (
    DYNAMICS_RANGES,
    EncoderOffsets,
    RandomCourse,
    RandomDynamics,
    RandomPushes,
    ReferenceStart,
)

Stack = dict[str, Transform]
"""Name -> transform, first to last; each environment gets copies of them."""


def insert_before(stack: Stack, name: str, **new: Transform) -> Stack:
    """Copy of a stack with more transforms, inserted before the named one.

    Raises:
        ConfigurationError: `stack` is a name, or has a new transform's name already.
        UnknownNameError: the stack has no transform of that name.
    """
    require_names(stack, [name])
    if taken := sorted(new.keys() & stack.keys()):
        raise ConfigurationError(f"the stack has {taken} already; choose other names")
    longer: Stack = {}
    for key, transform in stack.items():
        if key == name:
            longer |= new
        longer[key] = transform
    return longer


def edit_stack(stack: Stack, drop: Iterable[str], replace: Mapping[str, Transform]) -> Stack:
    """Copy of a stack with some transforms dropped and some replaced.

    Raises:
        UnknownNameError: the stack has no transform of that name.
    """
    drop = [drop] if isinstance(drop, str) else list(drop)
    require_names(stack, [*drop, *replace])
    return {name: replace.get(name, t) for name, t in stack.items() if name not in drop}


def require_names(stack: Stack, names: Iterable[str]) -> None:
    """Check that a stack has transforms of these names.

    Raises:
        ConfigurationError: `stack` is a name.
        UnknownNameError: a transform is missing; the message suggests the nearest name.
    """
    if isinstance(stack, str):
        raise ConfigurationError(
            f"stack must be a stack, such as default_stack(), not the name {stack!r}"
        )
    for name in names:
        if name not in stack:
            raise UnknownNameError.among("transform", name, stack)


def randomise_stack(
    stack: Stack, ranges: Mapping[str, tuple[float, float]] = DYNAMICS_RANGES
) -> Stack:
    """Copy of a stack with domain randomisation: each reset draws the dynamics.

    Args:
        stack: the stack.
        ranges: parameter -> least and greatest value; `sensor_noise` is a factor on the levels of
            `ObservationNoise`.

    Raises:
        ConfigurationError: `stack` is a name, or randomised already.
        UnknownNameError: the stack has no transform `start`.
    """
    return insert_before(stack, "start", dynamics=RandomDynamics(ranges))


def needs_simulation(transform: Transform) -> bool:
    """True for a transform that reads the truth, or changes the state or the simulated robot."""
    groups = {key if isinstance(key, str) else key[0] for key in transform.in_keys}
    kinds = ReferenceStart | RandomCourse | RandomDynamics | EncoderOffsets | RandomPushes
    return isinstance(transform, kinds) or bool(groups & {"truth", "true_odometry"})
