"""Second robot: a biped with six motors per leg and no loops, from an MJCF and a `Robot`."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without type stubs

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from aslip.errors import UnreachablePoseError
from aslip.ik import BodyTarget, Kinematics, solve, static_torque
from aslip.library import GaitLibrary
from aslip.robot import CASSIE, SIDES, Robot
from aslip.rom import PendulumWalk

# name, axis, position in the parent, lowest and highest angle, angle of the standing pose
JOINTS = (
    ("hip_yaw", "0 0 1", "0 {y} -0.05", -0.8, 0.8, 0.0),
    ("hip_roll", "1 0 0", "0 0 -0.02", -0.6, 0.6, 0.0),
    ("hip_pitch", "0 1 0", "0 0 -0.03", -1.5, 1.0, -0.4),
    ("knee", "0 1 0", "0 0 -0.4", 0.05, 2.2, 0.8),
    ("ankle_pitch", "0 1 0", "0 0 -0.4", -1.4, 1.0, -0.4),
    ("ankle_roll", "1 0 0", "0 0 -0.02", -0.5, 0.5, 0.0),
)


def _leg(side: str, y: float) -> str:
    opened = "".join(
        f'<body name="{side}_{name}" pos="{place.format(y=y)}">'
        f'<joint name="{side}_{name}" axis="{axis}" range="{low} {high}"/>'
        '<geom size="0.04" mass="1.5"/>'
        for name, axis, place, low, high, _ in JOINTS
    )
    foot = f'<geom name="{side}_foot" size="0.01"/><site name="{side}_sole" pos="0.03 0 -0.05"/>'
    return opened + foot + "</body>" * len(JOINTS)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    names = tuple(f"{side}_{joint[0]}" for side in SIDES for joint in JOINTS)
    motors = "".join(f'<motor name="{name}" joint="{name}"/>' for name in names)
    angles = " ".join(str(joint[-1]) for joint in JOINTS)
    sensors = "".join(
        f'<framelinvel name="{side}_foot_velocity" objtype="site" objname="{side}_sole"/>'
        f'<contact name="{side}_ground_force" geom1="floor" geom2="{side}_foot" num="1"'
        ' data="force" reduce="netforce"/>'
        for side in SIDES
    )
    path: Path = tmp_path_factory.mktemp("robot") / "biped.xml"
    path.write_text(
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody>'
        '<geom name="floor" type="plane" size="0 0 1"/>'
        '<body name="trunk" pos="0 0 1"><freejoint name="trunk"/><geom size="0.1" mass="15"/>'
        f'<site name="imu"/>{_leg("left", 0.1)}{_leg("right", -0.1)}</body></worldbody>'
        f"<actuator>{motors}</actuator>"
        f'<sensor>{sensors}</sensor><keyframe><key name="standing" qpos="0 0 0.9 1 0 0 0'
        f' {angles} {angles}"/></keyframe></mujoco>'
    )
    return dataclasses.replace(
        CASSIE,
        model_file=path,
        motor_names=names,
        joint_names=(),
        spring_names=(),
        foot_sites=("left_sole", "right_sole"),
        pelvis="trunk",
    )


@pytest.fixture(scope="module")
def kinematics(robot: Robot) -> Kinematics:
    return Kinematics(robot)


def test_feet_meet_their_targets_in_all_six_axes(robot, kinematics):
    count, rng = 30, np.random.default_rng(0)

    def body(mean, spread) -> tuple[np.ndarray, ...]:
        turn = np.concatenate((np.ones((count, 1)), rng.uniform(-0.1, 0.1, (count, 3))), axis=1)
        moves = rng.normal(size=(2, count, 3))
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        return (mean + rng.uniform(-spread, spread, (count, 3)), turn, *moves)

    bodies = body((0, 0, 0.78), 0.02), body((0.1, 0.1, 0.05), 0.05), body((-0.1, -0.1, 0.05), 0.05)
    solution = solve(kinematics, *(BodyTarget(*arrays) for arrays in bodies))
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    data, velocity, wanted = mujoco.MjData(model), np.zeros(6), np.zeros(9)
    for i in range(count):
        data.qpos, data.qvel = solution.qpos[i], solution.qvel[i]
        mujoco.mj_forward(model, data)
        for name, arrays in zip(robot.foot_sites, bodies[1:], strict=True):
            site, kind = model.site(name).id, mujoco.mjtObj.mjOBJ_SITE
            position, orientation, linear, angular = (array[i] for array in arrays)
            mujoco.mju_quat2Mat(wanted, orientation)
            np.testing.assert_allclose(data.site_xpos[site], position, atol=1e-12)
            np.testing.assert_allclose(data.site_xmat[site], wanted, atol=1e-12)
            mujoco.mj_objectVelocity(model, data, kind, site, velocity, 0)
            np.testing.assert_allclose(velocity[:3], angular, atol=1e-11)
            np.testing.assert_allclose(velocity[3:], linear, atol=1e-11)


def test_second_robot_stands_and_carries_a_load(robot: Robot, kinematics: Kinematics) -> None:
    qpos = robot.standing[None]
    torque = static_torque(kinematics, qpos, np.array([[[0.0, 0.0, 100.0], [0.0, 0.0, 100.0]]]))
    left, right = torque.reshape(2, len(JOINTS))
    np.testing.assert_allclose(left, right * [-1, -1, 1, 1, 1, -1], atol=1e-9)
    # the knee is in front of the line of the force
    knee = [joint[0] for joint in JOINTS].index("knee")
    assert abs(left[knee]) > 10


def test_motions_are_tabulated_for_a_second_robot(robot: Robot, tmp_path: Path) -> None:
    walk = PendulumWalk(speed=0.3, height=0.78, width=0.2, clearance=0.1)
    with pytest.warns(UserWarning, match="that of the only motion"):
        library = GaitLibrary.from_motions([walk], robot, samples=16, torque_jumps=True)
    library.save(tmp_path / "biped.npz")
    loaded = GaitLibrary.load(tmp_path / "biped.npz", robot)
    phase = torch.arange(16, dtype=torch.float64)[:, None] / 16
    qpos, _ = loaded.initial_state(phase, torch.full_like(phase, 0.3))
    kinematics = Kinematics(robot)
    soles = kinematics.legs(kinematics.to_pinocchio(qpos.numpy())).position
    expected = loaded.table.foot_position[0] + loaded.table.body_position[0][:, None]
    np.testing.assert_allclose(soles, expected, atol=1e-9)
    assert loaded.lookup(phase, torch.full_like(phase, 0.3)).motor_torque.shape == (16, 12)


def test_limiting_joint_is_named(kinematics: Kinematics) -> None:
    feet = [BodyTarget(np.array([[0.0, y, 0.4]])) for y in (0.1, -0.1)]
    with pytest.raises(UnreachablePoseError, match=r"left_knee would be at .* from 0\.0500 to"):
        solve(kinematics, BodyTarget(np.array([[0.0, 0.0, 0.9]])), *feet)
