"""Kinematics and spring forces of the legs equal MuJoCo's."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import mujoco
import numpy as np
import pytest
import torch

from aslip import GaitLibrary
from aslip.estimation.legs import FORCE, HEEL, LATERAL, TOE, LegKinematics
from aslip.robot import CASSIE, SIDES
from aslip.sim import Simulations


@pytest.fixture(scope="module")
def legs() -> LegKinematics:
    return LegKinematics()


def _random(model: mujoco.MjModel, num: int) -> np.ndarray:
    """(num, 35) configurations; hips, knees, springs and feet anywhere, loops not closed."""
    rng = np.random.default_rng(0)
    qpos = np.tile(model.key("standing").qpos, (num, 1))
    qpos[:, 3:7] = rng.normal(size=(num, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    indices = CASSIE.indices
    for joints in (indices.motor_qpos, indices.joint_qpos):
        qpos[:, joints] += rng.uniform(-0.4, 0.4, (num, len(joints)))
    return qpos


def test_feet_are_where_mujoco_has_them(model: mujoco.MjModel, legs: LegKinematics) -> None:
    indices, data = CASSIE.indices, mujoco.MjData(model)
    qpos = _random(model, 50)
    vectors = legs(qpos[:, indices.motor_qpos], qpos[:, indices.joint_qpos])
    assert vectors.shape == (50, 2, 4, 3)
    for row, found in zip(qpos, vectors, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        origin, turn = data.body("pelvis").xpos, data.body("pelvis").xmat.reshape(3, 3)
        for leg, side in enumerate(SIDES):
            geom = model.geom(f"{side}_foot")
            site = data.site_xmat[indices.foot_site[leg]].reshape(3, 3)
            centre = data.geom_xpos[geom.id] - origin
            half = site[:, 0] * geom.size[1]
            world = found[leg] @ turn.T
            np.testing.assert_allclose(world[HEEL], centre - half, atol=1e-9)
            np.testing.assert_allclose(world[TOE], centre + half, atol=1e-9)
            np.testing.assert_allclose(world[LATERAL], site[:, 1], atol=1e-9)


def test_legs_take_any_leading_shape(model: mujoco.MjModel, legs: LegKinematics) -> None:
    indices, qpos = CASSIE.indices, _random(model, 12)
    motors, joints = qpos[:, indices.motor_qpos], qpos[:, indices.joint_qpos]
    flat = legs(motors, joints)
    np.testing.assert_array_equal(
        legs(motors.reshape(3, 4, 10), joints.reshape(3, 4, 6)), flat.reshape(3, 4, 2, 4, 3)
    )
    np.testing.assert_allclose(legs(motors[5], joints[5]), flat[5], atol=1e-12)


def test_undeflected_springs_give_no_force(model: mujoco.MjModel, legs: LegKinematics) -> None:
    """The library's poses have undeflected springs and closed loops."""
    library, indices = GaitLibrary.load(), CASSIE.indices
    phase = torch.linspace(0, 0.95, 20)[:, None]
    qpos, _ = library.initial_state(phase, torch.full_like(phase, 1.0))
    rows = np.asarray(qpos).reshape(20, -1)
    force = legs(rows[:, indices.motor_qpos], rows[:, indices.joint_qpos])[..., FORCE, :]
    assert np.abs(force).max() < 1.0


def test_forces_of_a_standing_robot_add_up_to_its_weight() -> None:
    """Up to neglected terms: 16 N below the springs of each leg, and the ankle torque."""
    simulations = Simulations(1, num_threads=1)
    indices = simulations.indices
    target = simulations.qpos[:, indices.motor_qpos].copy()
    loads, felt = [], []
    legs = LegKinematics()
    for _ in range(12):
        simulations.advance(target)
        packets = simulations.sensors.packets()
        vectors = legs(packets["motor_position"], packets["joint_position"])
        loads.append(simulations.snapshot().ground_force[0, :, 2].copy())
        felt.append(vectors[0, :, :, FORCE, 2].mean(0))
    load, force = np.array(loads)[4:].mean(0), np.array(felt)[4:].mean(0)
    assert load.sum() == pytest.approx(9.81 * CASSIE.total_mass, rel=0.05)
    np.testing.assert_allclose(force, load, rtol=0.25)


def test_forces_are_the_slope_of_the_springs_energy(
    model: mujoco.MjModel, legs: LegKinematics
) -> None:
    """Virtual work: moving the foot, the work of the force equals the energy stored in the springs.

    With the motors held, shin and tarsus are moved a little; MuJoCo closes the loop of the Achilles
    rod by the heel spring, found here by bisection on the rod's length.
    """
    indices, data = CASSIE.indices, mujoco.MjData(model)
    joints = {name: model.joint(f"left_{name}") for name in ("shin", "tarsus", "heel_spring")}
    addresses = {name: joint.qposadr[0] for name, joint in joints.items()}
    loop = next(
        one for one in CASSIE.skeleton.connections.values()
        if {one.first, one.second} == {"left_achilles_rod", "left_heel_spring"}
    )  # fmt: skip
    rod_end, tip = np.array([loop.first_point, loop.second_point])
    if loop.first == "left_heel_spring":
        rod_end, tip = tip, rod_end
    length = np.linalg.norm(rod_end)

    def stretch(qpos: np.ndarray) -> float:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        spring = data.body("left_heel_spring")
        point = spring.xpos + spring.xmat.reshape(3, 3) @ tip
        return float(np.linalg.norm(point - data.body("left_achilles_rod").xpos) - length)

    def closed(qpos: np.ndarray) -> np.ndarray:
        low, high = -0.3, 0.3
        rising = stretch(_with(qpos, low)) < stretch(_with(qpos, high))
        for _ in range(60):
            middle = (low + high) / 2
            if (stretch(_with(qpos, middle)) < 0) == rising:
                low = middle
            else:
                high = middle
        return _with(qpos, low)

    def _with(qpos: np.ndarray, angle: float) -> np.ndarray:
        qpos = qpos.copy()
        qpos[addresses["heel_spring"]] = angle
        return qpos

    def energy_and_foot(shin: float, tarsus: float) -> tuple[float, np.ndarray]:
        qpos = model.key("standing").qpos.copy()
        qpos[addresses["shin"]] += shin
        qpos[addresses["tarsus"]] += tarsus
        qpos = closed(qpos)
        energy = sum(
            0.5 * joints[name].stiffness[0] * qpos[addresses[name]] ** 2
            for name in ("shin", "heel_spring")
        )
        vectors = legs(qpos[indices.motor_qpos], qpos[indices.joint_qpos])[0]
        return energy, (vectors[HEEL] + vectors[TOE]) / 2

    shin, tarsus, h = -0.05, -0.03, 1e-5
    qpos = model.key("standing").qpos.copy()
    qpos[addresses["shin"]] += shin
    qpos[addresses["tarsus"]] += tarsus
    force = legs(qpos[indices.motor_qpos], qpos[indices.joint_qpos])[0, FORCE]
    for step in ((h, 0.0), (0.0, h)):
        high, low = (
            energy_and_foot(shin + sign * step[0], tarsus + sign * step[1]) for sign in (1, -1)
        )
        stored, moved = high[0] - low[0], high[1] - low[1]
        # the heel spring's deflection is to first order: some percent at 0.1 rad
        assert force @ moved == pytest.approx(stored, rel=0.1)
    assert np.linalg.norm(force) > 50
