"""Targets and comparisons of batches of simulations."""

# pyright: reportAttributeAccessIssue=false

import numpy as np

from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.sim import Simulations


def random_targets(num: int, steps: int, seed: int = 0) -> np.ndarray:
    """(steps, num, 10) targets around the standing pose."""
    model = load_model()
    standing = model.key("standing").qpos[CASSIE.indices.motor_qpos]
    noise = np.random.default_rng(seed).uniform(-0.4, 0.4, (steps, num, 10))
    return standing + noise


def arrays(simulations: Simulations) -> dict[str, np.ndarray]:
    snapshot = simulations.snapshot()
    return {name: np.array(value) for name, value in vars(snapshot).items()}


def assert_rows_equal(a: Simulations, b: Simulations, rows: list[int]) -> None:
    left, right = arrays(a), arrays(b)
    for name in left:
        np.testing.assert_array_equal(left[name][rows], right[name][rows], err_msg=name)
