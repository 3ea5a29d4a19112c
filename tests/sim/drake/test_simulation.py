"""Robot in Drake with drive and sensors, against `Simulations` and the laws of motion."""

# Drake's stubs give arrays a wrong shape
# pyright: reportReturnType=false

import numpy as np
import pytest

from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.sim import Simulations, true_state

pytest.importorskip("pydrake", exc_type=ImportError)

from aslip.sim.drake import DrakeSimulation

AT = CASSIE.indices
STANDING = CASSIE.standing[None, AT.motor_qpos]
PERIOD = CASSIE.policy_period


@pytest.fixture(scope="module")
def drake() -> DrakeSimulation:
    return DrakeSimulation()


def in_the_air() -> tuple[np.ndarray, np.ndarray]:
    """State of a robot that turns and moves in the air with its joints at rest."""
    qpos, qvel = CASSIE.standing.copy(), np.zeros(AT.num_qvel)
    qpos[2], qpos[3:7] = 3.0, [0.8, 0.36, -0.48, 0.0]
    qvel[:6] = [0.5, -0.3, 0.2, 0.8, -0.6, 0.4]
    return qpos, qvel


def test_truth_after_a_reset_is_mujoco_s(drake: DrakeSimulation) -> None:
    qpos, qvel = in_the_air()
    drake.reset(qpos, qvel)
    other = Simulations(1, num_threads=1)
    other.reset(np.arange(1), qpos[None], qvel[None])
    ours, theirs = (true_state(s.snapshot(), AT) for s in (drake, other))
    for name in ours.keys() - {"pelvis_acceleration", "ground_force", "motor_torque"}:
        np.testing.assert_allclose(ours[name], theirs[name], atol=1e-12, err_msg=name)


def test_readings_and_power_in_the_air_are_those_of_mujoco_with_stiff_loops(
    drake: DrakeSimulation,
) -> None:
    """Drake's loops are rigid; the MJCF's give way by a quarter of a millimetre here."""
    qpos, qvel = in_the_air()
    model = load_model(visual=False)
    model.eq_solref[:, 0], model.eq_solimp[:, :2] = 0.001, 0.999
    other = Simulations(1, num_threads=1, model=model)
    drake.reset(qpos, qvel)
    other.reset(np.arange(1), qpos[None], qvel[None])
    target = STANDING + 0.2
    for simulation in (drake, other):
        simulation.advance(target)
    ours, theirs = drake.sensors.packets(), other.sensors.packets()
    tolerance = {
        "motor_position": 1e-3,
        "motor_velocity": 0.2,
        "joint_position": 1e-3,
        "joint_velocity": 0.1,
        "orientation": 1e-5,
        "gyro": 2e-3,
        "accelerometer": 0.1,
    }
    assert abs(theirs["motor_position"][:, -1] - STANDING).max() > 0.03
    for name, limit in tolerance.items():
        np.testing.assert_allclose(ours[name], theirs[name], atol=limit, err_msg=name)
    used, expected = (simulation.snapshot().motor_power for simulation in (drake, other))
    np.testing.assert_allclose(used, expected, rtol=2e-3)


def test_ground_force_is_the_change_of_momentum_and_weight(drake: DrakeSimulation) -> None:
    drake.reset()
    momentum = []
    for _ in range(3):
        drake.advance(STANDING)
        momentum.append(CASSIE.total_mass * _velocity(drake))
    force = drake.snapshot().ground_force[0].sum(axis=0)
    weight = CASSIE.total_mass * 9.81
    assert force[2] > 0.3 * weight
    expected = (momentum[-1] - momentum[-2]) / PERIOD + [0, 0, weight]
    np.testing.assert_allclose(force, expected, atol=1e-3 * weight)
    mean, largest = drake.snapshot().ground_force[..., 2], drake.snapshot().largest_force
    assert largest.shape == (1, 2)
    assert (largest > mean).all() and (largest < 60 * mean).all()


def test_a_push_in_the_air_changes_the_momentum_by_force_times_time(
    drake: DrakeSimulation,
) -> None:
    drake.reset(*in_the_air())
    before = _velocity(drake)
    drake.advance(STANDING, push=np.array([[30.0, -60.0, 0.0]]))
    pushed = _velocity(drake)
    drake.advance(STANDING)
    fall = np.array([0, 0, -9.81 * PERIOD])
    change = np.array([30.0, -60.0, 0.0]) * PERIOD / CASSIE.total_mass
    np.testing.assert_allclose(pushed - before, change + fall, atol=1e-4)
    np.testing.assert_allclose(_velocity(drake) - pushed, fall, atol=1e-4)


def test_a_robot_that_diverges_stands_again(drake: DrakeSimulation) -> None:
    drake.reset()
    before = drake.divergences
    assert drake.advance(np.full((1, 10), np.nan)).tolist() == [True]
    assert drake.divergences == before + 1
    assert drake.advance(STANDING).tolist() == [False]


def _velocity(drake: DrakeSimulation) -> np.ndarray:
    """Velocity of the centre of mass (3,) [m/s]."""
    return drake._plant.CalcCenterOfMassTranslationalVelocityInWorld(drake._state)
