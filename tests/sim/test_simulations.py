"""N simulations equal a naive loop and do not affect each other."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import mujoco
import numpy as np
import pytest

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE
from aslip.robot.model import load_model, physics_timesteps
from aslip.sim import Simulations
from tests.helpers import motor_torque
from tests.sim.batches import random_targets

WEIGHT = CASSIE.total_mass * 9.81


class NaiveLoop:
    """Loop over `mj_step` for one robot, with motor encoders and their velocity filter."""

    TAPS = (2727, 534, -2658, -795, 72, 110, 19, -6, -3)
    COUNTS = 2.0 ** np.array([13, 13, 13, 13, 18] * 2) / (2 * np.pi)

    def __init__(self, timestep: float = CASSIE.physics_timestep) -> None:
        self.model = load_model(timestep=timestep)
        self.indices = CASSIE.indices
        self.data = mujoco.MjData(self.model)
        self.reset()

    def reset(self, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None) -> None:
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("standing").id)
        if qpos is not None:
            self.data.qpos = qpos
        if qvel is not None:
            self.data.qvel = qvel
        angle, speed = self._motors()
        self.history = [
            self._count(angle - k * CASSIE.physics_timestep * speed)
            for k in range(1, len(self.TAPS) + 1)
        ]

    def _motors(self) -> tuple[np.ndarray, np.ndarray]:
        indices = self.indices
        return self.data.qpos[indices.motor_qpos], self.data.qvel[indices.motor_qvel]

    def _count(self, angle: np.ndarray) -> np.ndarray:
        return np.trunc(angle / (1 / self.COUNTS / CASSIE.gear))

    def reading(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity of the motors, from the counts of the last nine substeps."""
        speed = sum(tap * count for tap, count in zip(self.TAPS, self.history, strict=True))
        radians = 1 / self.COUNTS / CASSIE.gear
        return self.history[0] * radians, speed * (radians / np.pi)

    def advance(self, target: np.ndarray) -> np.ndarray:
        """One policy period; returns the mean ground force."""
        force = np.zeros((2, 3))
        coarse = self.model.opt.timestep > CASSIE.physics_timestep
        steps = CASSIE.substeps // 2 if coarse else CASSIE.substeps
        for _ in range(steps):
            # the PD loop uses the reading of the previous substep
            self.data.ctrl = motor_torque(target, *self.reading())
            self._read(self._motors()[0])
            if coarse:
                self.data.ctrl = (self.data.ctrl + motor_torque(target, *self.reading())) / 2
            mujoco.mj_step(self.model, self.data)
            if coarse:
                angle, speed = self._motors()
                self._read(angle - CASSIE.physics_timestep * speed)
            force += self.data.sensordata[self.indices.ground_force]
        return force / steps

    def _read(self, angle: np.ndarray) -> None:
        self.history = [self._count(angle), *self.history[:-1]]


@pytest.mark.parametrize("timestep", physics_timesteps())
def test_simulations_equal_a_loop_over_mj_step_bit_for_bit(timestep: float) -> None:
    """Some simulations are reset in between, to standing or another state."""
    num, steps = 3, 12
    targets = random_targets(num, steps)
    model = load_model(visual=False, timestep=timestep)
    simulations = Simulations(num, model=model, num_threads=1)
    loops = [NaiveLoop(timestep) for _ in range(num)]
    start = loops[0].model.key("standing").qpos.copy()
    start[[0, 2]] += [0.4, 0.3]
    velocity = np.random.default_rng(1).uniform(-0.3, 0.3, 32)
    for k, target in enumerate(targets):
        if k == 4:
            simulations.reset(np.array([1]))
            loops[1].reset()
        if k == 7:
            simulations.reset(np.array([0, 2]), np.stack([start] * 2), np.stack([velocity] * 2))
            loops[0].reset(start, velocity)
            loops[2].reset(start, velocity)
        assert not simulations.advance(target).any()
        forces = [loop.advance(row) for loop, row in zip(loops, target, strict=True)]
        snapshot = simulations.snapshot()
        np.testing.assert_array_equal(snapshot.qpos, [loop.data.qpos for loop in loops])
        np.testing.assert_array_equal(snapshot.qvel, [loop.data.qvel for loop in loops])
        np.testing.assert_array_equal(snapshot.ground_force, forces)
    # feet and sensors of the snapshot belong to its state, not to the previous substep
    for i, loop in enumerate(loops):
        acceleration = loop.data.qacc.copy()
        mujoco.mj_step1(loop.model, loop.data)
        np.testing.assert_array_equal(snapshot.site_xpos[i], loop.data.site_xpos)
        np.testing.assert_array_equal(snapshot.site_xmat[i], loop.data.site_xmat)
        velocities = loop.indices.foot_velocity
        np.testing.assert_array_equal(
            snapshot.sensordata[i][velocities], loop.data.sensordata[velocities]
        )
        np.testing.assert_array_equal(snapshot.qacc[i], acceleration)


def test_half_as_many_physics_steps_give_nearly_the_same_motion() -> None:
    """A quarter of a second from standing, landing and falling, sensors included."""
    model = load_model(visual=False, timestep=physics_timesteps()[1])
    fine, coarse = Simulations(3, num_threads=1), Simulations(3, model=model, num_threads=1)
    start = fine.qpos.copy()
    start[:, 2] += [0.0, 0.02, 1.0]
    for simulations in (fine, coarse):
        simulations.reset(np.arange(3), start)
    for target in random_targets(3, 1).repeat(8, 0):
        fine.advance(target)
        coarse.advance(target)
        np.testing.assert_allclose(fine.qpos, coarse.qpos, rtol=0, atol=0.005)
        a, b = fine.sensors.packets(), coarse.sensors.packets()
        for name, largest in {
            "motor_position": 0.005,
            "joint_position": 0.005,
            "orientation": 0.002,
        }.items():
            np.testing.assert_allclose(a[name], b[name], rtol=0, atol=largest, err_msg=name)
    assert np.abs(fine.qpos - start).max(1).min() > 0.3


def test_physics_steps_are_one_or_two_periods_of_the_motors_loop() -> None:
    model = load_model()
    model.opt.timestep = 0.002
    with pytest.raises(ConfigurationError, match=r"timestep.*0\.0005, 0\.001.*0\.002"):
        Simulations(1, model=model)
    with pytest.raises(ConfigurationError, match=r"timestep.*0\.0005, 0\.001.*0\.002"):
        load_model(timestep=0.002)
    coarse = Simulations(1, model=load_model(timestep=physics_timesteps()[1]))
    with pytest.raises(ConfigurationError, match=r"0\.0005 s, got 0\.001 s"):
        coarse.watch(0)


# -------------------------------------------------------------- resets


# -------------------------------------------------------------- misuse


@pytest.mark.parametrize("shape", [(1, 10), (2, 9)])
def test_targets_of_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError, match=r"motor_target must have shape \(2, 10\)"):
        Simulations(2, num_threads=1).advance(np.zeros(shape))


@pytest.mark.parametrize(("name", "size"), [("qpos", 34), ("qpos", 36), ("qvel", 35)])
def test_initial_states_of_wrong_shape_are_refused(name: str, size: int) -> None:
    simulations = Simulations(2, num_threads=1)
    with pytest.raises(ShapeError, match=name):
        simulations.reset(np.array([0]), **{name: np.zeros((1, size))})


# ------------------------------------------------------------- physics


def test_mean_ground_force_is_weight_plus_change_of_momentum() -> None:
    """Newton's second law over 0.6 s, in which only the feet touch the floor."""
    simulations = Simulations(1, num_threads=1)
    model, data = simulations.model, mujoco.MjData(simulations.model)
    standing = model.key("standing").qpos[simulations.indices.motor_qpos][None]

    def momentum() -> np.ndarray:
        data.qpos, data.qvel = simulations.snapshot().qpos[0], simulations.snapshot().qvel[0]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        touching = {model.geom(i).name for pair in data.contact.geom for i in pair}
        assert touching <= {"floor", "left_foot", "right_foot"}
        return CASSIE.total_mass * data.subtree_linvel[0]

    before, impulse, steps = momentum(), np.zeros(3), 20
    for _ in range(steps):
        simulations.advance(standing)
        impulse += simulations.snapshot().ground_force[0].sum(axis=0) * CASSIE.policy_period
        after = momentum()
    gained = after - before + [0, 0, WEIGHT * steps * CASSIE.policy_period]
    assert np.abs(after - before).max() > 1.0  # the robot does move
    np.testing.assert_allclose(impulse, gained, atol=0.01 * WEIGHT * steps * CASSIE.policy_period)


def test_motor_power_is_the_mean_positive_power_of_the_substeps() -> None:
    simulations = Simulations(2, num_threads=1)
    at = simulations.indices
    simulations.watch(1)
    simulations.advance(random_targets(2, 1)[0])
    rows = simulations.watched
    qvel = rows[:, simulations.qpos.shape[1] :][:, at.motor_qvel]
    torque = rows[:, simulations.qpos.shape[1] + simulations.qvel.shape[1] :][:, :10]
    expected = np.maximum(torque * qvel, 0.0).mean(axis=0)
    found = simulations.snapshot().motor_power
    np.testing.assert_allclose(found[1], expected, rtol=1e-12)
    assert expected.sum() > 10.0  # the motors do work
    simulations.stand()
    assert (found == 0).all()


def test_largest_force_is_that_of_the_substep_in_which_a_foot_bears_most() -> None:
    simulations = Simulations(2, num_threads=1)
    simulations.watch(1)
    largest = 0.0
    for target in random_targets(2, 8):
        simulations.advance(target)
        found = simulations.snapshot()
        expected = simulations.watched[:, -6:].reshape(-1, 2, 3)[..., 2].max(axis=0)
        np.testing.assert_array_equal(found.largest_force[1], expected)
        assert (found.largest_force >= found.ground_force[..., 2]).all()
        largest = max(largest, expected.max())
    assert largest > WEIGHT  # feet hit the floor
    simulations.stand()
    standing = simulations.snapshot()
    np.testing.assert_array_equal(standing.largest_force, standing.ground_force[..., 2])


def test_imu_measures_free_fall_with_coarse_steps() -> None:
    model = load_model(visual=False, timestep=physics_timesteps()[1])
    coarse = Simulations(1, model=model, num_threads=1)
    start = coarse.qpos.copy()
    target = start[:, coarse.indices.motor_qpos]
    start[:, 2] += 1.0
    coarse.reset(np.arange(1), start)
    coarse.advance(target)
    coarse.advance(target)
    assert np.abs(coarse.sensors.packets()["accelerometer"]).max() < 0.5
