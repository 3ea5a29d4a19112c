"""Exported policies run without PyTorch, as the controller does, and refuse what does not fit."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from aslip.control import Controller
from aslip.control.contract import TOLERANCE, csv, trace_text
from aslip.control.estimates import standing_estimate
from aslip.control.export import export_policy
from aslip.control.export.golden import golden_trace
from aslip.control.exported import ExportedController
from aslip.errors import ConfigurationError, FileDamagedError, ShapeError
from aslip.library import GaitLibrary
from aslip.network.runner.load import load
from aslip.network.runner.supervisor import Reading, Request, Stage, Supervisor
from aslip.robot import CASSIE
from aslip.transforms import DIRECTION_TABLE
from tests.control.helpers import altered, estimate, standing_packet


def test_the_golden_trace_is_the_controllers(
    controller: Controller, trace: dict[str, np.ndarray]
) -> None:
    again = golden_trace(controller)
    assert again.keys() == trace.keys()
    for name, values in again.items():
        np.testing.assert_array_equal(values, trace[name], err_msg=name)
    assert trace["target"].shape == (200, 10)
    assert np.isnan(trace["estimate"]).any()
    outside = trace["command"] - controller.library.nearest(torch.tensor(trace["command"])).numpy()
    assert np.abs(outside).max() > 0.01


def test_the_pose_is_that_of_the_reference_in_place(
    controller: Controller, exported: ExportedController
) -> None:
    zero = torch.zeros(1, 1)
    pose = controller.library.lookup(zero, zero).motor_position[0].numpy()
    np.testing.assert_array_equal(exported.pose.astype(np.float32), pose)
    assert exported.command_size == 1


def test_a_runner_walks_with_the_file_as_with_the_policy(file: Path) -> None:
    ours, theirs = load(file), load("straight")
    np.testing.assert_allclose(ours.controller.pose, theirs.controller.pose, atol=1e-6)
    targets = []
    for loaded in (ours, theirs):
        supervisor = Supervisor(loaded.controller)
        readings = [Reading(0.03 * k, standing_estimate(), np.ones(16) * 0.4) for k in range(5)]
        requests = [Request(0.5, yaw_rate=0.3)] * 5
        ticks = [supervisor.tick(r.time, r, q) for r, q in zip(readings, requests, strict=True)]
        targets.append([command.position for command in ticks])
        assert supervisor.stage is Stage.WALK
    np.testing.assert_allclose(targets[0], targets[1], atol=TOLERANCE)
    with pytest.raises(ConfigurationError, match="contains its library"):
        load(file, "gaits")


def test_motor_targets_are_those_of_the_controller(
    controller: Controller, exported: ExportedController
) -> None:
    assert exported.verify() <= TOLERANCE
    assert exported.verify(golden_trace(controller, 50, seed=1)) <= TOLERANCE


def test_further_steps_are_compared_before_a_file_is_replaced(
    controller: Controller,
    file: Path,
    trace: dict[str, np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, lengths = tmp_path / "aslip.onnx", []
    path.write_bytes(b"good")
    graph = onnx.load_from_string(file.read_bytes())
    del graph.metadata_props[:]

    def lost(controller: Controller, steps: int = 200, seed: int = 0) -> dict[str, np.ndarray]:
        lengths.append((steps, seed))
        return {**trace, "target": trace["target"] * (np.nan if seed else 1.0)}

    monkeypatch.setattr("aslip.control.export.policy.trace_graph", lambda *_: graph)
    monkeypatch.setattr("aslip.control.export.policy.golden_trace", lost)
    with pytest.raises(FileDamagedError, match="differ by nan rad"):
        export_policy(controller, path, steps=3)
    assert lengths == [(200, 0), (3, 1)]
    assert path.read_bytes() == b"good"
    assert [found.name for found in tmp_path.iterdir()] == ["aslip.onnx"]


@pytest.mark.slow
def test_the_robust_policy_is_exported(library: GaitLibrary, tmp_path: Path) -> None:
    export_policy("robust", tmp_path / "robust.onnx", library, steps=50)


def test_packets_are_tracked_as_by_the_controller(
    controller: Controller, exported: ExportedController
) -> None:
    """The estimator turns estimates to the heading, and bridges lost packets."""
    rng = np.random.default_rng(5)
    packet = standing_packet() + 0.01 * rng.standard_normal((12, 1, 10, 42))
    packet[..., -10:-6] /= np.linalg.norm(packet[..., -10:-6], axis=-1, keepdims=True)
    packet[4, 0, 3, 5] = np.nan
    theirs = controller.start(packet[0], 0.4, heading=0.3, phase=0.2)
    ours = exported.start(packet[0], 0.4, heading=0.3, phase=0.2)
    for i, row in enumerate(packet[1:]):
        got = None if i == 6 else row
        turn = 0.7 if i == 8 else None
        theirs, expected = controller.step(theirs, got, 0.9, heading=turn)
        ours, found = exported.step(ours, got, 0.9, heading=turn)
        np.testing.assert_allclose(found, expected.numpy(), rtol=0, atol=TOLERANCE)


def test_wrong_arguments_are_named(
    exported: ExportedController, trace: dict[str, np.ndarray]
) -> None:
    good = estimate(trace["estimate"][0])
    with pytest.raises(ShapeError, match=r"command must be one number or \(1, 1\)"):
        exported.start(good, [0.1, 0.2])
    for name, wrong in (("height", np.nan), ("orientation", 0.0)):
        lost = {**good, name: np.full_like(good[name], wrong)}
        with pytest.raises(ConfigurationError, match=f"must be finite and possible: {name} is"):
            exported.start(lost)
        # held in a step, which does not change its state, as an estimate that does not come
        state = exported.start(good)
        _, held = exported.step(state, lost)
        np.testing.assert_array_equal(held, exported.step(state, None)[1])
    with pytest.raises(ShapeError, match="must come from 1 robots, got 2"):
        exported.start(np.zeros((2, 1, 42)))
    assert not exported.stands
    assert "stand" not in exported.start(good, stand=0.0).entries
    with pytest.raises(ConfigurationError, match="cannot stand"):
        exported.start(good, stand=1.0)
    with pytest.raises(ConfigurationError, match="got packets, but the robots started with esti"):
        exported.step(exported.start(good), np.zeros((1, 1, 42)))


def test_another_robot_is_refused(file: Path) -> None:
    for name, value in {
        "motor_names": (*CASSIE.motor_names[1:], CASSIE.motor_names[0]),
        "stiffness": CASSIE.stiffness * 1.1,
        "torque_limit": CASSIE.torque_limit * 2,
        "substeps": 40,
        "torque_delay": 0.0,
        "joint_names": CASSIE.joint_names[:4],
    }.items():
        other: dict[str, Any] = {name: value}
        with pytest.raises(ConfigurationError, match=f"{name} is .* in the file and .* of this"):
            ExportedController(file, replace(CASSIE, **other))


def test_another_contract_version_is_refused(file: Path, tmp_path: Path) -> None:
    about = json.loads(ExportedController(file).contract.metadata["aslip"])
    other = altered(file, tmp_path / "other.onnx", aslip=json.dumps({**about, "contract": 99}))
    with pytest.raises(ConfigurationError, match="version 99, this package reads 3"):
        ExportedController(other)


def test_a_wrong_golden_trace_is_caught(
    file: Path, trace: dict[str, np.ndarray], tmp_path: Path
) -> None:
    wrong = {**trace, "target": trace["target"].copy()}
    wrong["target"][150, 3] += 3e-5
    other = altered(file, tmp_path / "other.onnx", golden_trace=trace_text(wrong))
    with pytest.raises(
        FileDamagedError, match=r"differ by [23].* rad from those of its golden trace"
    ):
        ExportedController(other).verify()
    other = altered(file, tmp_path / "other.onnx", golden_trace="???")
    with pytest.raises(FileDamagedError, match="golden trace cannot be run"):
        ExportedController(other).verify()


def test_other_inputs_than_in_the_contract_are_caught(file: Path, tmp_path: Path) -> None:
    interface = ExportedController(file).contract.metadata["interface"]
    renamed = interface.replace('"name": "height"', '"name": "altitude"')
    other = altered(file, tmp_path / "other.onnx", interface=renamed)
    with pytest.raises(
        FileDamagedError, match=r"inputs of its graph differ from its contract: .*al"
    ):
        ExportedController(other)


def test_policies_that_see_more_than_an_estimate_are_not_exported(library: GaitLibrary) -> None:
    seeing = Controller(
        Controller("straight", library).policy, library, observation=DIRECTION_TABLE
    )
    with pytest.raises(ConfigurationError, match=r"observes \['odometry/path_error'\]"):
        export_policy(seeing, "never.onnx")
    assert not Path("never.onnx").exists()


def test_the_contract_describes_the_graph(exported: ExportedController) -> None:
    contract = exported.contract
    named = {entry["name"]: entry for entry in (*contract.inputs, *contract.outputs)}
    assert named["velocity"]["unit"] == "m/s"
    assert named["motor_position"]["elements"] == [*CASSIE.motor_names]
    assert named["last_heading"]["dtype"] == named["heading"]["dtype"] == "float64"
    last = {entry["name"] for entry in contract.inputs if entry["name"].startswith("last_")}
    assert {f"last_{name}" for name in contract.feedback} == last
    assert contract.metadata["joint_stiffness"] == csv(CASSIE.stiffness)
    assert contract.numbers("joint_damping") == CASSIE.damping.tolist()
    assert contract.metadata["observation_names"].split(",")[0] == "estimate/height"


HIDDEN = """
import sys
names = "torch torchrl tensordict mujoco dm_control casadi pinocchio"
for name in names.split():
    sys.modules[name] = None  # lacking on the robot
import numpy as np
from aslip.control.exported import ExportedController
controller = ExportedController(sys.argv[1])
print(controller.verify(), "numba" in sys.modules)
state = controller.start(np.full((1, 1, 42), np.nan), 0.5)  # with the estimator
state, target = controller.step(state, None)
np.save(sys.argv[2], target)
"""


def test_an_exported_policy_needs_neither_pytorch_nor_a_simulator(
    file: Path, controller: Controller, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", HIDDEN, file, tmp_path / "target.npy"]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert float(found[0]) <= TOLERANCE
    assert found[1] == "False"  # the estimator is loaded for packets only
    state = controller.start(np.full((1, 1, 42), np.nan), 0.5)
    _, expected = controller.step(state, None)
    np.testing.assert_allclose(np.load(tmp_path / "target.npy"), expected, rtol=0, atol=TOLERANCE)
