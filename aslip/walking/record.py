"""Recording of walks as arrays for metrics.

    walks = record_walks(policy, env, command)      # (m, n) commanded speeds of n robots

`walk` is the loop of every recording and evaluation: policy steps without exploration noise and
resets. For recurrent policies, recordings add the transforms of the hidden state to the
environment (`aslip.policy.add_memory`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any, Final, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from aslip.base.decorators import on_cpu_in_single
from aslip.envs import StackEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.policy import add_memory
from aslip.robot import SIDES
from aslip.robot.rotation import rotate_level
from aslip.transforms import RandomCommand, StandCommand

_FEET: Final = tuple(f"{side}_foot_position" for side in SIDES)
_PELVIS: Final = ("pelvis_position", "pelvis_orientation", "pelvis_velocity")
_FORCE: Final[NestedKey] = ("next", "truth", "ground_force")
# groups with the robot's position: simulated truth, or the estimator's odometry
_PLACES: Final = ("true_odometry", "odometry")
# array of `Walks` -> entry of a policy step, for the other arrays
_RECORDED: Final[dict[str, NestedKey]] = {
    "phase": ("next", "phase"),
    "reward": ("next", "reward"),
    "action": "action",
    "body_position": ("next", "reference", "body_position"),
    "body_velocity": ("next", "reference", "body_velocity"),
}


@dataclass(frozen=True)
class Walks:
    """n walks of m policy steps; rows are the ends of the steps.

    Rows after a fall are NaN, except for `alive` and `command`. Positions, orientations and
    velocities are in the robot's heading frame, see `aslip.transforms.HeadingFrame`, which moves
    along the path in stacks with several axes of commands. Without a simulation, pelvis and feet
    come from the state estimator, and ground forces are NaN.
    """

    command: np.ndarray
    """(m, n) commanded speed during the step [m/s], or (m, n, c) for c axes of commands."""
    alive: np.ndarray
    """(m, n) true until the fall."""
    phase: np.ndarray
    """(m, n) stride fraction."""
    reward: np.ndarray
    """(m, n) reward of the step."""
    action: np.ndarray
    """(m, n, 10) action [rad]."""
    pelvis_position: np.ndarray
    """(m, n, 3) position of the pelvis [m]."""
    pelvis_orientation: np.ndarray
    """(m, n, 4) orientation of the pelvis, wxyz."""
    pelvis_velocity: np.ndarray
    """(m, n, 3) velocity of the pelvis [m/s]."""
    foot_position: np.ndarray
    """(m, n, 2, 3) sole centres, left and right [m]."""
    ground_force: np.ndarray
    """(m, n, 2, 3) ground force on each foot, mean over the step [N, world]."""
    body_position: np.ndarray
    """(m, n, 3) body of the reduced-order model; x is the deviation from uniform motion [m]."""
    body_velocity: np.ndarray
    """(m, n, 3) velocity of the model's body [m/s]."""
    body_to_foot: np.ndarray
    """(m, n, 2, 3) feet of the reduced-order model, from its body [m]."""
    frame: np.ndarray
    """(m, n, 3) pose of the heading frame in that after the first step: x, y [m] and yaw [rad].
    Zero for frames at rest."""

    def __post_init__(self) -> None:
        """Check that all arrays have m steps and n walks.

        Raises:
            ShapeError: an array has another shape.
        """
        for field in fields(self):
            shape = getattr(self, field.name).shape
            if shape[:2] != (expected := self.command.shape[:2]):
                raise ShapeError(
                    f"{field.name} must begin with {expected} as the command, got {shape}"
                )

    @property
    def speed(self) -> np.ndarray:
        """(m, n) commanded forward speed during the step [m/s]."""
        return self.command if self.command.ndim == 2 else self.command[..., 0]

    @property
    def survived(self) -> np.ndarray:
        """(n,) true for walks without a fall."""
        return self.alive[-1]

    @property
    def pelvis_place(self) -> np.ndarray:
        """(m, n, 2) pelvis along the ground, in the heading frame after the first step [m]."""
        turned = rotate_level(self.pelvis_position[..., :2], self.frame[..., 2])
        return turned + self.frame[..., :2]

    @property
    def foot_place(self) -> np.ndarray:
        """(m, n, 2, 2) sole centres along the ground, left and right, in that frame [m]."""
        turned = rotate_level(self.foot_position[..., :2], self.frame[..., None, 2])
        return turned + self.frame[..., None, :2]

    def one(self, index: int, start: int = 0, stop: int | None = None) -> Walks:
        """Slice of one walk, n = 1: steps `start` to `stop`."""
        rows = slice(start, stop), slice(index, index + 1)
        return Walks(*(getattr(self, field.name)[rows] for field in fields(self)))


@torch.no_grad()
@on_cpu_in_single
def take_step(policy: TensorDictModuleBase, env: StackEnv, td: TensorDictBase) -> TensorDictBase:
    """Take one policy step without exploration noise; the outcome is under `"next"`."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return env.step(policy(td))


def next_start(td: TensorDictBase) -> TensorDictBase:
    """Tensordict from which the step after `td` starts; a push ends with its policy step."""
    return step_mdp(td).exclude("push")


def walk(
    policy: TensorDictModuleBase,
    env: StackEnv,
    td: TensorDictBase,
    steps: int,
    *,
    command: np.ndarray | None = None,
    stand: np.ndarray | None = None,
    push: np.ndarray | None = None,
) -> Iterator[TensorDictBase]:
    """Walk from a tensordict, which is not modified; fallen robots are not reset.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment of n robots, in the state that belongs to the tensordict.
        td: start of the first step.
        steps: number of policy steps m.
        command: (m, n) commanded speed of each step [m/s], or (m, n, c) for c axes of commands; by
            default the tensordict's.
        stand: (m, n) stand command in each step, for stacks of robots that stand; by
            default the tensordict's.
        push: (n, 3) force on the pelvis throughout [N, world].

    Yields:
        Each policy step, with its outcome under `"next"`.
    """
    td = td.clone()
    for i in range(steps):
        if command is not None:
            td["command"] = _columns(command[i])
        if stand is not None:
            td["stand"] = _columns(stand[i])
        if push is not None:
            td["push"] = torch.from_numpy(push).float()
        td = take_step(policy, env, td)
        yield td
        td = next_start(td)


@on_cpu_in_single
def reset_walks(
    env: StackEnv,
    command: np.ndarray,
    phase: np.ndarray | float = 0.0,
    stand: np.ndarray | float = 0.0,
) -> TensorDictBase:
    """Reset all robots onto the reference.

    Args:
        env: environment of n robots.
        command: (n,) commanded speeds [m/s], or (n, c) for c axes of commands.
        phase: stride fraction, one or (n,).
        stand: 1 to stand and 0 to walk, one or (n,); walks by default.

    Raises:
        ConfigurationError: a robot is to stand, and the stack has no stand command.
    """
    values = {"command": command, "phase": np.broadcast_to(phase, len(command))}
    stands = checked_stand(env, np.broadcast_to(stand, len(command)), (len(command),))
    if stands is not None:
        values["stand"] = stands
    request = {name: _columns(value) for name, value in values.items()}
    return env.reset(TensorDict(request, batch_size=env.num_envs, device=env.device))


def can_stand(env: StackEnv) -> bool:
    """True if robots of an environment can stand, see `aslip.transforms.StandClock`."""
    return "stand" in env.observation_spec.keys()  # noqa: SIM118


def checked_stand(
    env: StackEnv, stand: np.ndarray | None, shape: tuple[int, ...]
) -> np.ndarray | None:
    """Stand commands of a shape; None for robots that cannot stand, which walk.

    Raises:
        ShapeError: `stand` has another shape.
        ConfigurationError: a robot is to stand, and the stack has no stand command.
    """
    stands = np.zeros(shape) if stand is None else np.asarray(stand)
    if stands.shape != shape:
        raise ShapeError(f"stand must be {shape} as the command, got {stands.shape}")
    if can_stand(env):
        return stands
    if np.any(stands > 0):
        raise ConfigurationError(
            "robots of this stack cannot stand; see aslip.envs.directions_stack"
        )
    return None


def _columns(values: np.ndarray) -> torch.Tensor:
    """Entry (n, k) from values (n,) or (n, k), in single precision."""
    return torch.tensor(values).float().reshape(len(values), -1)


@on_cpu_in_single
def record(
    policy: TensorDictModuleBase,
    env: StackEnv,
    command: np.ndarray,
    keys: Sequence[NestedKey],
    *,
    stand: np.ndarray | None = None,
    until_all_ended: bool = False,
) -> TensorDict:
    """Record entries of walks from phase 0 at given commands.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment of n robots; `add_memory` prepares it for a recurrent policy.
        command: (m, n) commanded speed of each policy step [m/s], or (m, n, c) for c axes.
        keys: entries of a policy step to record; absent ones are left out.
        stand: (m, n) stand command, 1 or 0, in each policy step; robots walk by default.
        until_all_ended: stop once the episode of every robot has ended.

    Returns:
        (m, n) policy steps, fewer if all episodes ended earlier.

    Raises:
        ShapeError: `stand` has another shape.
        ConfigurationError: a robot is to stand, and the stack has no stand command.
    """
    stand = checked_stand(env, stand, command.shape[:2])
    ended = torch.zeros(env.num_envs, dtype=torch.bool)
    rows: list[Any] = []  # torch.stack takes tensordicts, too
    with commands_kept(env):
        start = reset_walks(
            add_memory(env, policy), command[0], stand=0.0 if stand is None else stand[0]
        )
        for td in walk(policy, env, start, len(command), command=command, stand=stand):
            rows.append(td.select(*keys, strict=False).clone().cpu())
            ended |= td["next", "done"][:, 0].cpu()
            if until_all_ended and ended.all():
                break
    return cast("TensorDict", torch.stack(rows))


@contextmanager
def commands_kept(env: StackEnv) -> Iterator[None]:
    """Suspend the environment's own changes of the command, and its stand commands."""
    changing = [t for t in env.transforms if isinstance(t, RandomCommand | StandCommand)]
    kept = [(t, "interval", t.interval) for t in changing]
    kept += [(t, "share", t.share) for t in changing if isinstance(t, StandCommand)]
    for transform, name, _ in kept:
        setattr(transform, name, math.inf if name == "interval" else 0.0)
    try:
        yield
    finally:
        for transform, name, value in kept:
            setattr(transform, name, value)


@on_cpu_in_single
def record_walks(
    policy: TensorDictModuleBase,
    env: StackEnv,
    command: np.ndarray,
    stand: np.ndarray | None = None,
) -> Walks:
    """Walk from phase 0 without exploration noise.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment of n robots; without its `aslip.envs.EPISODE_ENDS` transforms walks end in
            falls only.
        command: (m, n) commanded forward speed of each policy step [m/s], or (m, n, c) for c axes.
        stand: (m, n) stand command, 1 or 0, in each policy step; robots walk by default.

    Raises:
        ShapeError: `command` or `stand` is not for n robots, or has no policy step.
        ConfigurationError: a command is not finite, the environment has no odometry, true or
            estimated, or a robot is to stand and cannot.
    """
    command = checked_commands(env, command, (env.num_envs,))
    if not np.isfinite(command).all():
        raise ConfigurationError("every commanded speed must be finite")
    place = next((name for name in _PLACES if name in env.observation_spec), None)
    if place is None:
        raise ConfigurationError(
            "walks need to know where robots are: the stack must have a `HeadingFrame`, which"
            " writes 'true_odometry', or an `EstimatedState`, which writes 'odometry'"
        )
    keys: list[NestedKey] = [("next", name) for name in ("terminated", "heading", place)]
    keys += [_FORCE, *_RECORDED.values(), *(("next", "reference", foot) for foot in _FEET)]
    return _as_walks(record(policy, env, command, keys, stand=stand), place, command)


def checked_commands(env: StackEnv, command: np.ndarray, robots: tuple[int, ...]) -> np.ndarray:
    """Commands of each policy step, in single precision, with all axes of the environment.

    Args:
        env: environment with c axes of commands.
        command: (m, *robots) forward speeds [m/s], or (m, *robots, c).
        robots: shape of a policy step's commands, without axes.

    Returns:
        Commands (m, *robots, c); (m, *robots) if c is 1.

    Raises:
        ShapeError: `command` has another shape, or no policy step.
    """
    command = np.asarray(command, dtype=np.float32)
    size = env.observation_spec["command"].shape[-1]
    if size > 1 and command.ndim and command.shape[1:] == robots:
        command = np.pad(command[..., None], [*[(0, 0)] * command.ndim, (0, size - 1)])
    expected = robots if size == 1 else (*robots, size)
    if not command.ndim or not len(command) or command.shape[1:] != expected:
        shown = ", ".join(["m", *map(str, expected)]) + ("" if expected else ",")
        raise ShapeError(
            f"command must be ({shown}) with a policy step or more, got {command.shape}"
        )
    return command


def frame_poses(origin: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Poses (m, n, 3) of a moving frame in its first one: x, y [m] and yaw [rad].

    Args:
        origin: (m, n, 3) origin [m, world].
        heading: (m, n, 1) yaw, -pi to pi [rad, world].

    Returns:
        The poses; their yaw counts whole turns.
    """
    yaw = np.unwrap(heading, axis=0) - heading[:1]
    displacement = rotate_level((origin - origin[:1])[..., :2], -heading[:1, :, 0])
    return np.concatenate([displacement, yaw], axis=-1)


def _as_walks(rows: TensorDict, place: str, command: np.ndarray) -> Walks:
    """Arrays of (m, n) policy steps; NaN from the step of a fall on."""
    fell = cast("torch.Tensor", rows["next", "terminated"])[..., 0]
    alive = ~np.logical_or.accumulate(fell.numpy(), axis=0)
    places = cast("TensorDict", rows["next", place])
    values = {name: cast("torch.Tensor", rows[key]) for name, key in _RECORDED.items()}
    values |= {name: places[name] for name in _PELVIS}
    values["ground_force"] = rows.get(_FORCE, torch.full((*fell.shape, 2, 3), torch.nan))
    for name, group in (("foot_position", place), ("body_to_foot", "reference")):
        values[name] = torch.stack([rows["next", group, foot] for foot in _FEET], dim=2)
    for name in ("phase", "reward"):
        values[name] = values[name][..., 0]
    arrays = {name: value.double().numpy() for name, value in values.items()}
    arrays["frame"] = np.zeros((*fell.shape, 3))
    if {"origin", "path_error"} <= set(places.keys()):
        moving: list[Any] = [places["origin"], rows["next", "heading"]]
        arrays["frame"] = frame_poses(*(value.double().numpy() for value in moving))
    for array in arrays.values():
        array[~alive] = np.nan
    return Walks(command=command.astype(np.float64), alive=alive, **arrays)
