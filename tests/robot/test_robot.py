"""Cassie's numbers are consistent, and its skeleton equals the compiled model."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import dataclasses
import pickle
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from aslip.robot import CASSIE, SIDES, mirror_name
from aslip.robot.compile import skeleton_of
from aslip.robot.model import load_model
from aslip.robot.skeleton import read_skeleton, write_skeleton

PER_MOTOR = ("gear", "no_load_speed", "torque_limit", "damping", "stiffness")


def test_both_legs_have_the_same_read_only_motors() -> None:
    for values in (getattr(CASSIE, name) for name in PER_MOTOR):
        assert values.shape == (10,)
        np.testing.assert_array_equal(values[:5], values[5:])
        assert (values > 0).all()
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0


def test_joint_torque_and_no_load_speed_follow_from_motor_and_gear() -> None:
    torque = CASSIE.torque_limit * CASSIE.gear
    np.testing.assert_allclose(torque[:5], [112.5, 112.5, 195.2, 195.2, 45.0])
    speed = CASSIE.no_load_speed / CASSIE.gear
    np.testing.assert_allclose(speed[:5], [12.147, 12.147, 8.508, 8.508, 11.519], atol=1e-3)


def test_packet_entries_follow_each_other() -> None:
    numbers = np.arange(CASSIE.packet_size)
    parts = [numbers[CASSIE.packet_slices[name]] for name in CASSIE.packet_sizes]
    np.testing.assert_array_equal(np.concatenate(parts), numbers)
    assert [part.size for part in parts] == list(CASSIE.packet_sizes.values())


def test_robots_survive_pickling() -> None:
    """Other processes make environments from pickled arguments."""
    copy = pickle.loads(pickle.dumps(CASSIE))
    assert repr(copy) == "Robot('cassie')"
    assert copy.skeleton == CASSIE.skeleton
    assert copy.motor_names == CASSIE.motor_names


# ------------------------------------------------------------------- numbers of the MJCF


def test_shipped_skeleton_equals_the_compiled_model_bit_for_bit(model: mujoco.MjModel) -> None:
    """After a change of the MJCF, rewrite it with `python -m aslip.robot`."""
    shipped = read_skeleton(CASSIE.mjcf, CASSIE.mjcf.with_suffix(".json"))
    assert shipped == skeleton_of(load_model(visual=False))
    assert CASSIE.skeleton == skeleton_of(model)
    np.testing.assert_array_equal(CASSIE.standing, model.key("standing").qpos)


def test_changed_mjcf_is_compiled_again(tmp_path: Path) -> None:
    file = tmp_path / "other.xml"
    shutil.copy(CASSIE.mjcf, file)
    write_skeleton(CASSIE.skeleton, file, file.with_suffix(".json"))
    robot = dataclasses.replace(CASSIE, model_file=file)
    assert robot.skeleton == CASSIE.skeleton
    file.write_text(file.read_text().replace('stiffness="1500"', 'stiffness="1400"'))
    robot = dataclasses.replace(CASSIE, model_file=file)
    assert robot.skeleton.joints["left_shin"].stiffness == 1400
    file.with_suffix(".json").unlink()
    assert dataclasses.replace(CASSIE, model_file=file).skeleton == robot.skeleton


# ------------------------------------------------------------------- indices


def test_indices_point_at_the_named_parts(model: mujoco.MjModel) -> None:
    indices = CASSIE.indices
    assert indices.motor_qpos.tolist() == [7, 8, 9, 14, 20, 21, 22, 23, 28, 34]
    assert indices.motor_qvel.tolist() == [6, 7, 8, 12, 18, 19, 20, 21, 25, 31]
    qpos = [model.joint(name).qposadr[0] for name in CASSIE.joint_names]
    assert qpos == indices.joint_qpos.tolist() == [15, 16, 20, 29, 30, 34]
    assert indices.joint_qvel.tolist() == [13, 14, 18, 26, 27, 31]
    assert [model.site(int(i)).name for i in indices.foot_site] == ["left_foot", "right_foot"]
    assert (indices.num_qpos, indices.num_qvel) == (model.nq, model.nv)
    assert model.body(indices.pelvis_body).name == CASSIE.pelvis
    with pytest.raises(ValueError, match="read-only"):
        indices.motor_qpos[0] = 0


def test_indices_split_the_pelvis_and_find_all_quaternions(model: mujoco.MjModel) -> None:
    at, data = CASSIE.indices, mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.qpos[at.pelvis_position], data.body("pelvis").xpos)
    np.testing.assert_array_equal(data.qpos[at.pelvis_orientation], [1, 0, 0, 0])
    free = model.joint("pelvis")
    velocity = np.arange(model.nv)[at.pelvis_velocity].tolist()
    assert velocity == [free.dofadr[0] + i for i in range(3)]
    spin = np.arange(model.nv)[at.pelvis_angular_velocity].tolist()
    assert spin == [free.dofadr[0] + 3 + i for i in range(3)]
    balls = [model.joint(f"{side}_achilles_rod").qposadr[0] for side in SIDES]
    assert [part.start for part in at.quaternions] == [3, *balls]
    for part in at.quaternions:
        assert np.linalg.norm(data.qpos[part]) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("names", [CASSIE.motor_names, CASSIE.joint_names, CASSIE.spring_names])
def test_left_comes_before_right_and_legs_are_named_alike(names: tuple[str, ...]) -> None:
    half = len(names) // 2
    assert all(name.startswith("left_") for name in names[:half])
    assert tuple(mirror_name(name) for name in names[:half]) == names[half:]


@pytest.mark.parametrize("name", [*CASSIE.motor_names, "left_right_thing"])
def test_mirroring_twice_changes_nothing(name: str) -> None:
    assert mirror_name(name) != name
    assert mirror_name(mirror_name(name)) == name
