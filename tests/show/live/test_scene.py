"""Scene nodes have the poses and colours of robot and model."""

import mujoco
import numpy as np
import pytest
import torch

from aslip.library.footholds import Footholds
from aslip.show.ghost import Ghost
from aslip.show.live.robot import RobotView
from aslip.show.live.scene import RomView, SceneView
from aslip.walking import Walker


@pytest.fixture
def walker(library) -> Walker:
    """Robot in mid-step, away from the world's x axis."""
    walker = Walker("straight", library=library, speed=1.0, seed=0)
    walker.push([0, 150, 0], 0.2)
    for _ in range(20):
        walker.step()
    return walker


def pose(scene, name: str) -> np.ndarray:
    """(4, 4) of a scene node in the scene."""
    whole, path = np.eye(4), ""
    for part in name.strip("/").split("/"):
        path += f"/{part}"
        node = scene.get_handle_by_name(path)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, node.wxyz)
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = rotation.reshape(3, 3), node.position
        whole = whole @ local
    return whole


def names(model: mujoco.MjModel) -> list[str]:
    """Names of the bodies in the scene."""
    names = ["/world/robot"]
    for body in range(1, model.nbody):
        names.append(f"{names[model.body_parentid[body]]}/{model.body(body).name}")
    return names[1:]


def test_body_poses_match_the_simulator(server, model, walker):
    qpos = walker.td["truth", "qpos"][0].numpy()
    RobotView(server.scene, model).update(qpos)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    assert np.abs(qpos[:2]).min() > 0.01
    for body, name in enumerate(names(model), start=1):
        place = pose(server.scene, name)
        expected = data.xpos[body] - [*qpos[:2], 0.0]
        # numbers that changed by less than 1e-5 are not sent
        np.testing.assert_allclose(place[:3, 3], expected, atol=1e-4)
        np.testing.assert_allclose(place[:3, :3].ravel(), data.xmat[body], atol=1e-4)


def test_springs_connect_body_and_feet_of_the_model(server, library, walker):
    RomView(server.scene, library).update(walker.td)
    ghost = Ghost.of(walker.td)
    origin = np.array([*ghost.body[:2], 0.0])
    body = pose(server.scene, "/world/rom/body")[:3, 3]
    np.testing.assert_allclose(body, ghost.body - origin, atol=1e-5)
    for side, foot in (("left", ghost.left), ("right", ghost.right)):
        leg = pose(server.scene, f"/world/rom/{side}")
        spring = server.scene.get_handle_by_name(f"/world/rom/{side}/spring")
        np.testing.assert_allclose(leg[:3, 3], foot - origin, atol=1e-5)
        # the far end of the skin moves with the second bone, the near end with the first
        end = leg @ [*spring.bones[1].position, 1.0]
        np.testing.assert_allclose(end[:3], body, atol=1e-4)
        np.testing.assert_array_equal(spring.bones[0].position, 0.0)
        top = spring.vertices[:, 2].argmax()
        weights = spring.skin_weights[top], spring.skin_indices[top]
        assert weights[0][list(weights[1]).index(1)] == pytest.approx(1.0, abs=0.02)


def test_leg_in_swing_is_pale_and_its_foothold_lies_on_the_floor(server, library, walker):
    view = RomView(server.scene, library)
    while not (ghost := Ghost.of(walker.td)).right_stance or ghost.left_stance:
        walker.step()
    view.update(walker.td)
    node = server.scene.get_handle_by_name
    left, right = (min(node(f"/world/rom/{side}/spring").color) for side in ("left", "right"))
    assert left > 100 > right
    assert node("/world/footholds/left_0").visible
    assert not node("/world/footholds/right_0").visible
    truth = walker.td["truth"]
    plan = Footholds(library).planned(
        "left", 1.0, truth["right_foot_position"][0].numpy(), truth["pelvis_orientation"][0].numpy()
    )
    drawn = node("/world/footholds/left_0").position
    np.testing.assert_allclose(drawn[:2], plan - ghost.body[:2], atol=1e-5)
    # ahead of the robot, on the floor
    assert drawn[0] > 0.1
    assert 0 < drawn[2] < 0.01


def test_model_is_beside_the_robot_in_its_place_or_hidden(server, library):
    view = RomView(server.scene, library)
    root = server.scene.get_handle_by_name("/world/rom")
    view.place("beside")
    assert root.visible
    assert np.linalg.norm(root.position) > 0.5
    view.place("hidden")
    assert not root.visible
    assert not server.scene.get_handle_by_name("/world/footholds").visible
    view.place("through")
    assert root.visible
    np.testing.assert_array_equal(root.position, 0.0)


def test_beside_is_to_the_right_of_a_robot_that_has_turned(server, library, walker):
    view = RomView(server.scene, library)
    view.place("beside")
    td, half = walker.td.clone(), np.radians(-150.0) / 2
    td["truth", "pelvis_orientation"][0] = torch.tensor([np.cos(half), 0, 0, np.sin(half)])
    view.update(td)
    place = server.scene.get_handle_by_name("/world/rom").position
    right = [np.sin(2 * half), -np.cos(2 * half), 0.0]
    np.testing.assert_allclose(place, 0.7 * np.array(right), atol=1e-6)
    # shown again without a step in between
    view.place("through")
    np.testing.assert_array_equal(server.scene.get_handle_by_name("/world/rom").position, 0.0)
    view.place("beside")
    place = server.scene.get_handle_by_name("/world/rom").position
    np.testing.assert_allclose(place, 0.7 * np.array(right), atol=1e-6)


def test_floor_moves_under_the_robot(server, model, library, walker):
    view = SceneView(server, model, library)
    floor = server.scene.get_handle_by_name("/world/floor")
    places = []
    for x, y in ((0.2, 0.1), (0.45, 0.1), (3.2, -1.9)):
        td = walker.td.clone()
        td["truth", "qpos"][0, :2] = torch.tensor([x, y])
        view.update(td)
        places.append(np.array(floor.position))
        # the drawn robot stays at the origin
        assert server.scene.get_handle_by_name("/world/robot/pelvis").position[0] == 0.0
    np.testing.assert_allclose(places[1] - places[0], [-0.25, 0, 0], atol=1e-12)
    # after whole squares the picture is the same
    np.testing.assert_allclose(places[2], places[0], atol=1e-12)


def test_floor_turns_so_that_a_robot_that_turns_faces_the_same_way(server, model, library, walker):
    view, heading = SceneView(server, model, library), np.radians(-150.0)
    view.place_rom("beside")
    td = walker.td.clone()
    view.update(td)
    robot, rom = (pose(server.scene, f"/world/{name}") for name in ("robot/pelvis", "rom/left"))
    # robot, heading and reference turn about the pelvis
    turn = np.array([np.cos(heading / 2), 0, 0, np.sin(heading / 2)])
    turned, qpos = np.empty(4), td["truth", "qpos"][0].double().numpy()
    mujoco.mju_mulQuat(turned, turn, qpos[3:7])
    td["truth", "qpos"][0, 3:7] = td["truth", "pelvis_orientation"][0] = torch.tensor(turned)
    td["heading"] += heading
    view.update(td)
    floor = pose(server.scene, "/world/floor")
    np.testing.assert_allclose(floor[0, :2], [np.cos(heading), np.sin(heading)], atol=1e-6)
    np.testing.assert_allclose(pose(server.scene, "/world/robot/pelvis"), robot, atol=1e-4)
    # place and direction; the coil may turn about the leg
    leg = pose(server.scene, "/world/rom/left")
    np.testing.assert_allclose(leg[:, 2:], rom[:, 2:], atol=1e-4)
