"""Packets of batches: threads, resets, states, copies and divergence."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from aslip.robot import CASSIE
from aslip.sim import SimulationPool, Simulations
from aslip.sim.readings import MOTOR_VELOCITY_TAPS
from tests.helpers import motor_torque


def _targets(pool: SimulationPool, rng: np.random.Generator) -> np.ndarray:
    standing = pool.model.key("standing").qpos[pool.indices.motor_qpos]
    return standing + rng.normal(0, 0.3, (pool.num, 10))


def test_drive_uses_the_readings_of_the_previous_substep() -> None:
    """The first torque uses the reading of the reset, 0.5 ms before it."""
    simulations = Simulations(1, num_threads=1)
    states: list[np.ndarray] = []
    torques: list[np.ndarray] = []
    original = simulations._step

    def step(failed: np.ndarray, stage: int) -> None:
        states.append(simulations.qpos[0, simulations.indices.motor_qpos].copy())
        torques.append(simulations.batch.bind("ctrl")[0].copy())
        original(failed, stage)

    simulations._step = step
    standing = simulations.qpos[:, simulations.indices.motor_qpos].copy()
    target = standing + np.random.default_rng(7).normal(0, 0.3, (1, 10))
    simulations.advance(target)
    step_size = 2 * np.pi / 2.0 ** np.array([13, 13, 13, 13, 18] * 2) / CASSIE.gear
    counts = np.trunc(np.array(states) / step_size)
    # the robot has always stood there
    counts = np.concatenate([np.repeat(counts[:1], len(MOTOR_VELOCITY_TAPS), axis=0), counts])
    velocity = lfilter(MOTOR_VELOCITY_TAPS / np.pi, 1.0, counts, axis=0) * step_size
    last = slice(len(MOTOR_VELOCITY_TAPS) - 1, -1)
    expected = motor_torque(target, counts[last] * step_size, velocity[last])
    np.testing.assert_allclose(torques, expected, atol=1e-9)
    assert np.ptp(torques, axis=0).max() > 0.1


def test_reset_clears_the_packets() -> None:
    used, fresh = SimulationPool(2), SimulationPool(2)
    rng = np.random.default_rng(8)
    for _ in range(3):
        used.advance(_targets(used, rng))
    used.reset(np.arange(2))
    for _ in range(2):
        for name, window in used.packets().items():
            np.testing.assert_array_equal(window, fresh.packets()[name], err_msg=name)
        targets = _targets(used, rng)
        used.advance(targets)
        fresh.advance(targets)


def test_saved_states_include_the_sensors() -> None:
    pool, other = SimulationPool(3), SimulationPool(3)
    rng = np.random.default_rng(4)
    for _ in range(3):
        pool.advance(_targets(pool, rng))
    saved, after = pool.states(), _targets(pool, rng)
    pool.advance(after)
    other.advance(_targets(other, rng))
    other.set_states(saved)
    other.advance(after)
    np.testing.assert_array_equal(pool.states(), other.states())
    for name, window in pool.packets().items():
        np.testing.assert_array_equal(window, other.packets()[name], err_msg=name)
