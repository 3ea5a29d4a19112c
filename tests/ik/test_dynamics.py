"""Torques of inverse dynamics change the energy of the legs as their power says."""

import mujoco
import numpy as np

from aslip.ik import BodyTarget, Kinematics, leg_torque, pelvis_axes, solve
from aslip.library.interpolation import open_slopes
from aslip.robot.model import load_model

STEP = 2e-3  # [s]


def swung() -> tuple[np.ndarray, np.ndarray]:
    """Configurations and velocities of legs that swing below a pelvis at rest."""
    time = STEP * np.arange(101)
    feet = []
    for side, phase in ((1, 0.0), (-1, 2.0)):
        angle = 9.0 * time + phase
        place = np.stack(
            [0.2 * np.sin(angle), 0.1 * side + 0 * time, 0.15 + 0.08 * np.cos(angle)], axis=1
        )
        rate = 9.0 * np.stack([0.2 * np.cos(angle), 0 * time, -0.08 * np.sin(angle)], axis=1)
        feet.append(BodyTarget(place, velocity=rate))
    pelvis = BodyTarget(np.tile([0.0, 0.0, 1.0], (len(time), 1)))
    pose = solve(Kinematics(), pelvis, *feet)
    return pose.qpos, pose.qvel


def energy(qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Kinetic and potential energy in MuJoCo, reflected inertia of the motors included [J]."""
    model = load_model()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, found = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:] in zip(qpos, qvel, strict=True):
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        springs = (
            0.5
            * model.jnt_stiffness
            @ np.square(data.qpos[model.jnt_qposadr] - model.qpos_spring[model.jnt_qposadr])
        )
        found.append(data.energy.sum() - springs)
    return np.array(found)


def test_power_of_the_torques_is_the_rate_of_the_energy() -> None:
    qpos, qvel = swung()
    kinematics = Kinematics()
    velocity = pelvis_axes(kinematics, qpos, qvel)
    acceleration = open_slopes(velocity[None])[0] / STEP
    torque = leg_torque(kinematics, qpos, velocity, acceleration)
    motors = kinematics.robot.indices.motor_qvel
    power = (torque * qvel[:, motors]).sum(axis=1)
    rate = open_slopes(energy(qpos, qvel)[None, :, None])[0, :, 0] / STEP
    assert np.abs(rate).max() > 20
    np.testing.assert_allclose(power[5:-5], rate[5:-5], atol=0.01 * np.abs(rate).max())


def test_a_turned_robot_needs_the_same_torques() -> None:
    """The heading is of no account, and neither is a steady speed."""
    kinematics, (qpos, qvel) = Kinematics(), swung()
    turned, moving = qpos.copy(), qvel.copy()
    turned[:, kinematics.robot.indices.pelvis_orientation] = [np.cos(0.4), 0, 0, np.sin(0.4)]
    moving[:, kinematics.robot.indices.pelvis_velocity] += [1.0, 0.5, 0.0]
    torques = []
    for configuration, rates in ((qpos, qvel), (turned, moving)):
        velocity = pelvis_axes(kinematics, configuration, rates)
        acceleration = open_slopes(velocity[None])[0] / STEP
        torques.append(leg_torque(kinematics, configuration, velocity, acceleration))
    np.testing.assert_allclose(torques[0], torques[1], atol=1e-8)
