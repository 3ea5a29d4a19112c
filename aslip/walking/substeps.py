"""Recording of a walk at the rate of the physics, for contacts, impacts and power.

    walk = record_substeps(policy, env, command)    # (m,) commanded speeds of one robot

The means over policy steps of `record_walks` hide impacts and short losses of contact.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import mujoco
import numpy as np
from tensordict.nn import TensorDictModuleBase

from aslip.envs import SimulatedEnv, StackEnv
from aslip.errors import ConfigurationError
from aslip.policy import add_memory
from aslip.robot import CASSIE
from aslip.walking.record import (
    checked_commands,
    checked_stand,
    commands_kept,
    reset_walks,
    walk,
)

_FORCES: Final = 6  # last columns of `SimulatedEnv.watched`, before them the torques


@dataclass(frozen=True)
class Substeps:
    """Walk of one robot, k substeps of 0.5 ms; rows are the ends of the substeps.

    Torques and forces are those that acted during the substep.
    """

    pelvis_position: np.ndarray
    """(k, 3) position of the pelvis [m, world]."""
    pelvis_orientation: np.ndarray
    """(k, 4) orientation of the pelvis, wxyz, to the world."""
    foot_position: np.ndarray
    """(k, 2, 3) sole centres, left and right [m, world]."""
    ground_force: np.ndarray
    """(k, 2, 3) force of the floor on each foot [N, world]."""
    motor_torque: np.ndarray
    """(k, 10) torques of the motors at the joints [N m]."""
    motor_velocity: np.ndarray
    """(k, 10) velocities of these joints [rad/s]."""
    fell: bool
    """True if the record ends in a fall."""

    def since(self, time: float) -> Substeps:
        """Part of the walk from a time after its start on [s]."""
        first = round(time / CASSIE.physics_timestep)
        arrays = {
            field.name: getattr(self, field.name)[first:]
            for field in fields(self)
            if field.name != "fell"
        }
        return Substeps(**arrays, fell=self.fell)


def record_substeps(
    policy: TensorDictModuleBase,
    env: StackEnv,
    command: np.ndarray,
    stand: np.ndarray | None = None,
) -> Substeps:
    """Walk from phase 0 without exploration noise, up to a fall.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment of one simulated robot; without its `aslip.envs.EPISODE_ENDS` transforms
            the walk ends in a fall only.
        command: (m,) commanded forward speed of each policy step [m/s], or (m, c) for c axes.
        stand: (m,) stand commands of each policy step, true to stand; by default it walks.

    Raises:
        ShapeError: `command` or `stand` has another shape, or no policy step.
        ConfigurationError: the environment has several robots, or no simulated one, or the robot
            is to stand, and the stack has no stand command.
    """
    command = checked_commands(env, command, ())
    base = env.base_env
    if env.num_envs != 1 or not isinstance(base, SimulatedEnv):
        raise ConfigurationError(
            f"env must have one simulated robot, got {env.num_envs} of {type(base).__name__}"
        )
    rows, fell = [], False
    with commands_kept(env):
        stand = checked_stand(env, None if stand is None else stand[:, None], (len(command), 1))
        first = 0.0 if stand is None else stand[0]
        start = reset_walks(add_memory(env, policy), command[:1], stand=first)
        base.watch(0)
        command = command[:, None]
        for td in walk(policy, env, start, len(command), command=command, stand=stand):
            rows.append(base.watched.copy())
            fell = bool(td["next", "terminated"])
            if fell:
                break
        base.watch(None)
    return _as_substeps(base.model, np.concatenate(rows), fell)


def _as_substeps(model: mujoco.MjModel, rows: np.ndarray, fell: bool) -> Substeps:
    """Named arrays from rows (k, 83) of `SimulatedEnv.watched`."""
    indices = CASSIE.indices
    qpos, qvel = rows[:, : model.nq], rows[:, model.nq : model.nq + model.nv]
    return Substeps(
        pelvis_position=qpos[:, indices.pelvis_position],
        pelvis_orientation=qpos[:, indices.pelvis_orientation],
        foot_position=_sole_centres(model, qpos),
        ground_force=rows[:, -_FORCES:].reshape(-1, 2, 3),
        motor_torque=rows[:, -_FORCES - model.nu : -_FORCES],
        motor_velocity=qvel[:, indices.motor_qvel],
        fell=fell,
    )


def _sole_centres(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """(k, 2, 3) positions of the sole centres in configurations (k, 35) [m, world]."""
    data = mujoco.MjData(model)
    found = np.empty((len(qpos), 2, 3))
    for row, at in zip(qpos, found, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        at[:] = data.site_xpos[CASSIE.indices.foot_site]
    return found
