"""Walks, and packets made by hand, for the tests of the estimator."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp

import aslip
from aslip.estimation import StateEstimator
from aslip.robot import CASSIE
from aslip.transforms import TrueState

AT = CASSIE.packet_slices
GYRO, ACCELEROMETER = AT["gyro"], AT["accelerometer"]
STEPS, ROBOTS = 50, 3
SPOILED = 20
"""Policy step with bad packets."""

WALKER = Path(__file__).parents[1] / "data" / "walker.zip"
"""Policy of the walk, a fixed one: errors of the estimate depend on how the robot walks."""

Spoil = Callable[[int, np.ndarray], np.ndarray]
"""Function of policy step and windows of packets that returns changed windows."""


class Walk:
    """Packets and true states of walking robots."""

    def __init__(self) -> None:
        env = aslip.make_env(
            num_envs=ROBOTS,
            num_threads=1,
            seed=1,
            drop=["noise", "low_reward", "fall", "step_limit"],
            replace={"estimator": TrueState()},
        )
        policy = aslip.load_policy(WALKER)
        td = cast("TensorDictBase", env.reset())
        packets, velocity, height = [], [], []
        with torch.no_grad():
            for _ in range(STEPS):
                entries = [
                    cast("torch.Tensor", td["sensors", name]) for name in CASSIE.packet_sizes
                ]
                packets.append(torch.cat(entries, -1).double().numpy())
                velocity.append(np.asarray(td["truth", "pelvis_velocity"]))
                height.append(np.asarray(td["truth", "pelvis_position"])[:, 2])
                td = step_mdp(env.step(policy(td)))
        self.packets = np.stack(packets, axis=1)  # (n, steps, W, 42), the first from the reset
        self.velocity, self.height = np.stack(velocity, axis=1), np.stack(height, axis=1)


def follow(walk: Walk, spoil: Spoil | None = None) -> list[dict[str, np.ndarray]]:
    """Estimates at each policy step, from windows that `spoil` may change."""
    estimator = StateEstimator()
    tracking, first = estimator.start(walk.packets[:, 0])
    estimates = [first]
    for step in range(1, STEPS):
        windows = walk.packets[:, step].copy()
        estimates.append(estimator.update(tracking, spoil(step, windows) if spoil else windows))
    names = ("velocity", "height", "orientation", "joint_position", "acceleration", "faults")
    return [{name: np.array(getattr(e, name)) for name in names} for e in estimates]


def standing_packet(turn: Rotation, gyro: np.ndarray, force: Any) -> np.ndarray:
    """Packet of a standing robot with attitude, angular velocity and specific force."""
    at = CASSIE.indices
    qpos = CASSIE.standing
    packet = np.zeros(CASSIE.packet_size)
    packet[AT["motor_position"]] = qpos[at.motor_qpos]
    packet[AT["joint_position"]] = qpos[at.joint_qpos]
    packet[AT["orientation"]] = turn.as_quat(canonical=True, scalar_first=True)
    packet[AT["gyro"]], packet[AT["accelerometer"]] = gyro, force
    return packet
