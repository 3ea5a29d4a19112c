"""Models of the robot, and poses to solve."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from aslip.ik import BodyTarget, Kinematics
from aslip.robot.model import load_model

Targets = tuple[BodyTarget, BodyTarget, BodyTarget]


@pytest.fixture(scope="session")
def kinematics() -> Kinematics:
    return Kinematics()


@pytest.fixture(scope="session")
def mujoco_model() -> mujoco.MjModel:
    return load_model()


@pytest.fixture(scope="session")
def random_qpos(mujoco_model: mujoco.MjModel) -> np.ndarray:
    """50 random configurations with open loops."""
    qpos = np.random.default_rng(0).uniform(-3, 3, (50, mujoco_model.nq))
    for configuration in qpos:
        mujoco.mj_normalizeQuat(mujoco_model, configuration)
    return qpos


def _swing(fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Progress along x (quintic, 0 to 1) and height (0 to 1 and back) of a swinging foot."""
    progress = 10 * fraction**3 - 15 * fraction**4 + 6 * fraction**5
    return progress, np.sin(np.pi * fraction) ** 3


@pytest.fixture(scope="session")
def walking_library() -> Targets:
    """Upright poses of walking: strides of up to 0.9 m, the swinging foot up to 0.2 m high."""
    height, sway, reach, fraction, swinging = (
        axis.ravel()
        for axis in np.meshgrid(
            np.linspace(0.80, 0.92, 4),
            (-0.013, 0.0, 0.013),
            np.linspace(-0.45, 0.45, 6),
            np.linspace(0, 1, 21),
            (0, 1),
            indexing="ij",
        )
    )
    progress, lift = _swing(fraction)
    forward = np.stack((reach * (1 - 2 * fraction), reach * (2 * progress - 1)))
    up = np.stack((np.zeros_like(lift), 0.2 * lift))
    rows = np.arange(len(height))
    feet = []
    for side, y in enumerate((0.1, -0.1)):
        role = np.where(swinging == side, 1, 0)
        feet.append(np.stack((forward[role, rows], np.full(len(rows), y), up[role, rows]), axis=1))
    pelvis = BodyTarget(np.stack((np.zeros_like(sway), sway, height), axis=1))
    return pelvis, BodyTarget(feet[0]), BodyTarget(feet[1])


@pytest.fixture(scope="session")
def smooth_motion() -> Callable[[np.ndarray], Targets]:
    """Targets along a motion in which pelvis and feet move and turn in all directions."""

    def wave(time: np.ndarray, mean: list, amplitude: list, rate: list) -> tuple:
        phase = time[:, None] * rate + np.arange(3)
        return (
            np.array(mean) + np.array(amplitude) * np.sin(phase),
            np.array(amplitude) * np.array(rate) * np.cos(phase),
        )

    def body(time: np.ndarray, mean: list, amplitude: list, axis: list, angle: float) -> BodyTarget:
        position, velocity = wave(time, mean, amplitude, [3.0, 4.0, 5.0])
        turn, turn_rate = angle * np.sin(2 * time), 2 * angle * np.cos(2 * time)
        unit = np.array(axis) / np.linalg.norm(axis)
        orientation = np.column_stack((np.cos(turn / 2), np.sin(turn / 2)[:, None] * unit))
        return BodyTarget(position, orientation, velocity, turn_rate[:, None] * unit)

    def motion(time: np.ndarray) -> Targets:
        return (
            body(time, [0.0, 0.0, 0.86], [0.05, 0.02, 0.04], [1.0, 2.0, 2.0], 0.08),
            body(time, [0.05, 0.12, 0.06], [0.25, 0.03, 0.05], [0.3, 1.0, 1.0], 0.15),
            body(time, [-0.05, -0.12, 0.06], [-0.25, 0.03, 0.05], [0.3, 1.0, -1.0], 0.15),
        )

    return motion
