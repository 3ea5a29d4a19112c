"""Golden trace of a controller: inputs and outputs of policy steps, computed by PyTorch.

The estimates follow the reference with noise, so that no simulator is needed. Commands change and
leave the library's region, the heading changes, estimates are lost, and the robot restarts once.
"""

from __future__ import annotations

from typing import Final, cast

import numpy as np
import torch
from torch import Tensor

from aslip.control.controller import PATH_ERROR, Controller, ControllerState
from aslip.control.estimates import join_estimate, split_estimate
from aslip.library import GaitLibrary
from aslip.robot import Robot
from aslip.robot.rotation import normalize

STEPS: Final = 200
"""Policy steps of a golden trace."""

_NOISE = 0.02  # standard deviation in any unit; about that of the sensors
_COMMAND_STEPS = 40  # policy steps between changes of the command
_BEYOND = 1.2  # size of the range of commands, relative to the library's
_LOST = range(60, 63)  # steps without an estimate
_TURN, _HEADING = 90, 0.25  # step at which the heading changes, and its new value [rad]
_RESTART = 120  # step at which the robot restarts
_PHASE = 0.25  # stride fraction at starts
_STANDS = (range(10, 90), range(110, 140))  # steps with the stand command; the restart is within
_PLACE = 0.1  # standard deviation of the distance from the path [m]


def golden_trace(
    controller: Controller, steps: int = STEPS, seed: int = 0
) -> dict[str, np.ndarray]:
    """Golden trace of a controller.

    Args:
        controller: the controller.
        steps: number t of policy steps.
        seed: seed of commands and noise.

    Returns:
        `target` (t, m) [rad], and the inputs `command` (t, c); `reset` (t,), True at steps that
        start; `estimate` (t, e), joined in the order of `Robot.estimate_sizes`, NaN if lost, with
        three numbers of the position at the end for policies that observe their path; `heading`
        (t, 1) [rad]; `phase` (1, 1) at starts; `stand` (t, 1) for policies that stand, through
        stops and starts.
    """
    step = np.arange(steps)
    generator = np.random.default_rng(seed)
    commands = random_commands(controller.library, -(-steps // _COMMAND_STEPS), generator)
    commands = commands[step // _COMMAND_STEPS]
    headings = np.where(step < _TURN, 0.0, _HEADING)[:, None]
    starts = np.isin(step, (0, _RESTART))
    stands = controller.stands
    stand = np.isin(step, [i for part in _STANDS for i in part])[:, None] * np.float32(stands)
    rows, states = [], []
    for i, start in enumerate(starts):
        last = None if start else states[-1]
        rows.append(_estimate(controller, last, commands[i : i + 1], generator))
        if i in _LOST:
            rows[-1] *= np.nan
        states.append(_state(controller, last, rows[-1], commands[i], headings[i], stand[i]))
    trace = {
        "target": np.concatenate([state.motor_target.numpy() for state in states]),
        "command": commands,
        "reset": starts,
        "estimate": np.concatenate(rows),
        "heading": headings,
        "phase": np.array([[_PHASE]], dtype=np.float32),
    }
    return {**trace, "stand": stand} if stands else trace


def _estimate(
    controller: Controller,
    last: ControllerState | None,
    command: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Random estimate (1, e) of a robot at the phase of its last state, or of a start."""
    phase, mode, origin = torch.tensor([[_PHASE]]), None, np.zeros((1, 3))
    if last is not None:
        entries = last.tensordict
        phase, mode = cast("Tensor", entries["phase"]), entries.get("mode", None)
        origin = cast("Tensor", entries.get(("odometry", "origin"), torch.zeros(1, 3))).numpy()
    robot = controller.robot
    row = random_estimates(controller.library, robot, phase, command, generator, mode)
    if PATH_ERROR not in controller.observation:
        return row
    return np.concatenate([row, origin + _PLACE * generator.standard_normal((1, 3))], axis=1)


def _state(
    controller: Controller,
    last: ControllerState | None,
    row: np.ndarray,
    command: np.ndarray,
    heading: np.ndarray,
    stand: np.ndarray,
) -> ControllerState:
    """State after a step of the trace."""
    estimate = split_estimate(row, controller.robot)
    given = {"stand": stand[None], "heading": heading[None]}
    if last is None:
        return controller.start(estimate, command[None], phase=_PHASE, **given)
    return controller.step(last, estimate, command[None], **given)[0]


def random_commands(library: GaitLibrary, count: int, generator: np.random.Generator) -> np.ndarray:
    """Random commands (count, c) from the range of a library, widened by a tenth at each end."""
    ends = np.array([(axis[0], axis[-1]) for axis in library.table.axes])
    share = 0.5 + _BEYOND * (generator.random((count, len(ends))) - 0.5)
    return (ends[:, 0] + share * (ends[:, 1] - ends[:, 0])).astype(np.float32)


def random_estimates(
    library: GaitLibrary,
    robot: Robot,
    phase: Tensor,
    command: np.ndarray,
    generator: np.random.Generator,
    mode: Tensor | None = None,
) -> np.ndarray:
    """Joined estimates (n, e) of robots in the state of the reference, with noise.

    Args:
        library: gaits.
        robot: robot.
        phase: (n, 1) stride fraction.
        command: (n, c) command.
        generator: source of the noise.
        mode: (n, 1) values of `aslip.library.WalkMode`; walking by default.
    """
    at = robot.indices
    state = library.initial_state(phase, torch.from_numpy(command), mode)
    qpos, qvel = (values.numpy() for values in state)
    estimate = {
        "height": qpos[:, at.pelvis_position][:, 2:],
        "orientation": qpos[:, at.pelvis_orientation],
        "velocity": qvel[:, at.pelvis_velocity],
        "angular_velocity": qvel[:, at.pelvis_angular_velocity],
        "acceleration": np.zeros((len(qpos), 3)),
        "motor_position": qpos[:, at.motor_qpos],
        "motor_velocity": qvel[:, at.motor_qvel],
        "joint_position": qpos[:, at.joint_qpos],
        "joint_velocity": qvel[:, at.joint_qvel],
    }
    rows = join_estimate(estimate, robot)
    noisy = split_estimate(rows + _NOISE * generator.standard_normal(rows.shape), robot)
    return join_estimate({**noisy, "orientation": normalize(noisy["orientation"])}, robot)
