"""Messages of a log equal the entries of the tensordict."""

import json
import platform
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

import aslip
from aslip.base.assets import asset_path
from aslip.base.provenance import commit
from aslip.envs import BatchEnv, default_stack
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.log import Recorder, Recording, read, replay
from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES, component_names
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost
from aslip.sim import Torque
from aslip.transforms import TrueState, WeightedReward
from tests.log.helpers import MakeRecorded, run

Walk = tuple[Path, list[TensorDict]]


def _ends(seen: list[TensorDict]) -> np.ndarray:
    """Ticks at which the policy steps of a walk end; a reset takes the time of one."""
    done = np.array([bool(td["next", "done"]) for td in seen])
    return 1 + np.arange(len(seen)) + np.concatenate([[0], np.cumsum(done)[:-1]])


def _at(recording: Recording, topic: str, seen: list[TensorDict]) -> np.ndarray:
    """Rows of a topic that belong to the ends of the policy steps."""
    return np.searchsorted(recording[topic].ticks, _ends(seen))


def test_step_topic_has_inputs_and_outcome(walk: Walk, recording: Recording) -> None:
    seen, step = walk[1], recording["/step"]
    np.testing.assert_allclose(step.time, _ends(seen) * CASSIE.policy_period, atol=1e-12)
    for i, td in enumerate(seen):
        after: Any = td["next"]
        assert step["phase"][i] == float(td["phase"])
        assert step["command"][i] == float(td["command"])
        assert step["reward"][i] == float(after["reward"])
        assert step["terminated"][i] == float(after["terminated"])
        for name, term in after["reward_terms"].items():
            assert step[f"term_{name}"][i] == float(term)
        actions = [step[f"action_{name}"][i] for name in CASSIE.motor_names]
        assert actions == td["action"][0].tolist()
        targets = [step[f"motor_target_{name}"][i] for name in CASSIE.motor_names]
        assert targets == (td["reference", "motor_target"] + td["action"])[0].tolist()
        force = [step[f"ground_force_{side}_z"][i] for side in ("left", "right")]
        assert force == after["truth", "ground_force"][0, :, 2].tolist()
    np.testing.assert_array_equal(np.flatnonzero(step["push_y"]), [3, 4])
    assert set(step["push_y"]) == {0.0, 20.0}


@pytest.mark.parametrize("group", ["truth", "estimate", "reference", "odometry", "true_odometry"])
def test_topics_have_the_entries_of_the_tensordict(
    walk: Walk, recording: Recording, group: str
) -> None:
    seen, series = walk[1], recording[f"/{group}"]
    rows = _at(recording, f"/{group}", seen)
    compared = 0
    for key, values in seen[0]["next", group].items():
        size = values[0].numel()
        names = {1: [key], 3: [f"{key}_{a}" for a in "xyz"], 4: [f"{key}_{a}" for a in "wxyz"]}
        names[10] = [f"{key}_{motor}" for motor in CASSIE.motor_names]
        for i, name in enumerate(names.get(size, [])):
            if name in series.columns:
                compared += 1
                expected = [float(td["next", group, key][0, i]) for td in seen]
                np.testing.assert_array_equal(series[name][rows], expected, err_msg=name)
    assert compared >= {"truth": 46, "estimate": 34, "reference": 28}.get(group, 20)


def test_joint_states_have_position_velocity_and_effort(walk: Walk, recording: Recording) -> None:
    model, series = load_model(), recording["/joint_states"]
    rows, seen = _at(recording, "/joint_states", walk[1]), walk[1]
    assert series["name"][0].tolist() == list(LOGGED_JOINTS)
    for k, td in enumerate(seen):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = td["next", "truth", "qpos"][0], td["next", "truth", "qvel"][0]
        mujoco.mj_forward(model, data)
        for i, name in enumerate(LOGGED_JOINTS):
            joint = data.joint(name)
            assert series["position"][rows[k], i] == joint.qpos[0]
            assert series["velocity"][rows[k], i] == joint.qvel[0]
            effort = series["effort"][rows[k], i]
            if i < len(CASSIE.motor_names):
                assert effort == float(td["next", "truth", "motor_torque"][0, i])
            else:
                np.testing.assert_allclose(effort, joint.qfrc_passive[0], rtol=1e-9, atol=1e-9)


def test_transforms_are_poses_of_robot_and_reduced_order_model(
    walk: Walk, recording: Recording
) -> None:
    model, series = load_model(), recording["/tf"]
    rows, seen = _at(recording, "/tf", walk[1]), walk[1]
    frames = series["transforms.child_frame_id"][0].tolist()
    assert set(series["transforms.header.frame_id"].ravel()) == {"world"}
    position, turn = (
        np.stack([series[f"transforms.transform.{part}.{axis}"] for axis in axes], axis=-1)
        for part, axes in (("translation", "xyz"), ("rotation", "wxyz"))
    )
    for k, td in enumerate(seen):
        data = mujoco.MjData(model)
        data.qpos[:] = td["next", "truth", "qpos"][0]
        mujoco.mj_kinematics(model, data)
        for body in range(1, model.nbody):
            i = frames.index(model.body(body).name)
            np.testing.assert_array_equal(position[rows[k], i], data.xpos[body])
            np.testing.assert_array_equal(turn[rows[k], i], data.xquat[body])
        ghost = Ghost.of(td["next"])
        for name, place in zip(ROM_FRAMES, (ghost.body, ghost.left, ghost.right), strict=True):
            np.testing.assert_array_equal(position[rows[k], frames.index(name)], place)
    seconds = series["transforms.header.stamp.sec"][:, 0]
    stamps = seconds + 1e-9 * series["transforms.header.stamp.nanosec"][:, 0]
    np.testing.assert_allclose(stamps, series.time, atol=1e-9)


def test_files_and_settings_are_attached(recording: Recording) -> None:
    files = recording.attachments
    assert files["model.xml"] == asset_path("cassie.xml").read_bytes()
    assert files["policy.zip"] == asset_path("policies/straight.zip").read_bytes()
    config = json.loads(files["config.json"])
    assert config["settings"] == {"why": "a test"}
    assert config["seed"] == 4
    assert config["backend"] == "BatchEnv"
    assert config["stack"]["reward"].startswith("WeightedReward(")
    assert recording.metadata["seed"] == "4"
    assert recording.metadata["commit"] == (commit() or "")
    assert recording.metadata["version/python"] == platform.python_version()
    assert recording.metadata["version/mujoco"] == mujoco.__version__
    assert recording.end["policy_steps"] == "100"


def test_episodes_and_their_ends_are_noted(walk: Walk, recording: Recording) -> None:
    notes = recording["/log"]["msg"]
    done = [i for i, td in enumerate(walk[1]) if td["next", "done"]]
    assert sum("begins" in text for text in notes) == len(done) + 1
    assert f"episode 0 ends after {done[0] + 1} steps: terminated" in notes
    assert recording.end["episodes"] == str(len(done) + 1)


def test_observation_and_packets_are_logged(walk: Walk, recording: Recording) -> None:
    seen = walk[1]
    observation, sensors = recording["/observation"], recording["/sensors"]
    assert list(observation.columns)[:3] == [
        "estimate_height", "estimate_orientation_w", "estimate_orientation_x"
    ]  # fmt: skip
    rows = _at(recording, "/observation", seen)
    logged = np.stack(list(observation.columns.values()), axis=1)[rows]
    expected = torch.cat([td["next", "observation"] for td in seen])
    np.testing.assert_array_equal(logged, expected)
    # the first is the first of the first episode
    assert observation.time[0] == 0
    first = np.stack([column[0] for column in observation.columns.values()])
    np.testing.assert_array_equal(first, seen[0]["observation"][0])
    for name, size in CASSIE.packet_sizes.items():
        columns = [sensors[part] for part in component_names(name, size)]
        packets = torch.cat([td["next", "sensors", name] for td in seen])
        np.testing.assert_array_equal(np.stack(columns, axis=-1)[rows], packets, err_msg=name)
    start = np.stack([sensors[f"gyro_{axis}"][0] for axis in "xyz"], axis=-1)
    np.testing.assert_array_equal(start, seen[0]["sensors", "gyro"][0])


def test_truncation_and_termination_are_logged_apart(
    make_recorded: MakeRecorded, tmp_path: Path
) -> None:
    """A time limit truncates an episode and does not terminate it."""
    env = make_recorded(tmp_path / "a.mcap", drop=["low_reward", "fall"], max_steps=3)
    run(env, 8, size=0.0)
    env.close()
    step = read(tmp_path / "a.mcap")["/step"]
    assert step["truncated"].tolist() == step["done"].tolist() == [0, 0, 1, 0, 0, 1, 0, 0]
    assert not step["terminated"].any()


@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_every_substep_can_be_logged(
    make_recorded: MakeRecorded, tmp_path: Path, backend: str
) -> None:
    path = tmp_path / "fast.mcap"
    env = make_recorded(path, backend, joint_rate="physics")
    seen = run(env, 4, size=0.0)
    env.close()
    joints = read(path)["/joint_states"]
    assert len(joints) == 1 + 4 * 60
    np.testing.assert_allclose(np.diff(joints.time), 0.0005, atol=1e-12)
    knee = load_model().joint("left_knee").qposadr[0]
    ends = [float(td["next", "truth", "qpos"][0, knee]) for td in seen]
    np.testing.assert_array_equal(joints["position"][60::60, 3], ends)
    # smooth in between
    speed = np.diff(joints["position"][:, 3]) / 0.0005
    np.testing.assert_allclose(speed, joints["velocity"][1:, 3], atol=0.1)


def test_both_backends_write_the_same_messages(make_recorded: MakeRecorded, tmp_path: Path) -> None:
    """Robot 2 of three, on both backends; the other robots are reset meanwhile."""
    logs = []
    for backend in ("batch", "dm_control"):
        path = tmp_path / f"{backend}.mcap"
        env = make_recorded(path, backend, num_envs=3, robot=2)
        run(env, 50)
        env.close()
        logs.append(read(path))
    first, second = logs
    assert first.end == second.end
    assert first.series.keys() == second.series.keys()
    for topic, series in first.series.items():
        np.testing.assert_array_equal(series.time, second[topic].time, err_msg=topic)
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, second[topic][name], err_msg=name)


def test_recording_does_not_change_the_simulation(
    make_recorded: MakeRecorded, tmp_path: Path, walk: Walk, library: GaitLibrary
) -> None:
    bare = aslip.make_env(stack=default_stack(library), seed=4, num_threads=1)
    for td, other in zip(run(bare, 40), walk[1], strict=False):
        torch.testing.assert_close(td["next", "truth", "qpos"], other["next", "truth", "qpos"])
        assert float(td["next", "reward"]) == float(other["next", "reward"])


def test_ablated_stacks_can_be_logged(library: GaitLibrary, tmp_path: Path) -> None:
    """A stack with the true state, fewer reward terms and another friction."""
    stack = default_stack(library)
    for name in ("noise", "foot_orient"):
        del stack[name]
    stack["estimator"] = TrueState()
    weights = {"com_vel": 0.5, "foot_pos": 0.5, "straight_diff": 0.0, "action_diff": 0.0}
    stack["reward"] = WeightedReward(weights)
    stack["recorder"] = Recorder(tmp_path / "a.mcap")
    env = aslip.make_env(stack=stack, num_threads=1, floor_friction=0.6, seed=0)
    run(env, 3)
    env.close()
    log = read(tmp_path / "a.mcap")
    assert "term_foot_orient" not in log["/step"].columns
    assert "contact_left" not in log["/estimate"].columns
    assert json.loads(log.attachments["model.json"])["floor_friction"] == 0.6
    assert replay(log).equal


def test_low_level_unknown_to_replays_is_refused(tmp_path: Path) -> None:
    stack = {**default_stack(), "recorder": Recorder(tmp_path / "walk.mcap")}
    env = aslip.make_env(base=partial(BatchEnv, drive=Torque), stack=stack, seed=0)
    with pytest.raises(ConfigurationError, match=r"cannot record drive=.*Torque"):
        env.reset()
    assert not list(tmp_path.iterdir())


def test_unknown_topics_and_columns_are_named(recording: Recording) -> None:
    with pytest.raises(UnknownNameError, match=r"/steps.*has no topic|no topic.*/steps"):
        _ = recording["/steps"]
    with pytest.raises(UnknownNameError, match="rewards"):
        _ = recording["/step"]["rewards"]


def test_robot_description_has_the_poses_of_the_first_transforms(recording: Recording) -> None:
    """Viewers show it before the first transform."""
    robot = ET.fromstring(recording["/robot_description"]["data"][0].encode())
    tf = recording["/tf"]
    frames = tf["transforms.child_frame_id"][0].tolist()
    joints = {str(joint.find("child").get("link")): joint for joint in robot.iter("joint")}  # pyright: ignore
    assert sorted(joints) == sorted(frames)
    assert {link.get("name") for link in robot.iter("link")} == {"world", *frames}
    for i, frame in enumerate(frames):
        origin = joints[frame].find("origin")
        assert origin is not None
        place = [float(part) for part in str(origin.get("xyz")).split()]
        angles = [float(part) for part in str(origin.get("rpy")).split()]
        first = [tf[f"transforms.transform.translation.{axis}"][0, i] for axis in "xyz"]
        turn = [tf[f"transforms.transform.rotation.{axis}"][0, i] for axis in "xyzw"]
        np.testing.assert_allclose(place, first, atol=1e-5)
        difference = Rotation.from_euler("xyz", angles) * Rotation.from_quat(turn).inv()
        assert difference.magnitude() < 1e-4
    model = load_model()
    shown = sum(model.geom_group == 1)
    assert len(list(robot.iter("visual"))) >= shown + len(ROM_FRAMES)


def test_chosen_robot_is_recorded(make_recorded: Any, tmp_path: Path) -> None:
    env = make_recorded(tmp_path / "a.mcap", num_envs=3, robot=2)
    seen: Any = run(env, 4)
    env.close()
    log = read(tmp_path / "a.mcap")
    assert log["/step"]["reward"].tolist() == [td["next", "reward"][2].item() for td in seen]
    assert log["/step"]["term_com_vel"].tolist() == [
        td["next", "reward_terms", "com_vel"][2].item() for td in seen
    ]
    for group, name in (("estimate", "velocity"), ("reference", "body_velocity")):
        expected = [td["next", group, name][2].tolist() for td in seen]
        assert log[f"/{group}"].vector(name)[1:].tolist() == expected
