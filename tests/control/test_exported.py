"""Exported policies run without PyTorch, as the controller does, and refuse what does not fit."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from aslip.control import Controller
from aslip.control.contract import TOLERANCE, csv, seal, trace_text
from aslip.control.estimates import standing_estimate
from aslip.control.export import export_policy
from aslip.control.export.golden import golden_trace
from aslip.control.exported import ExportedController
from aslip.errors import (
    AssetError,
    ConfigurationError,
    FileDamagedError,
    ShapeError,
)
from aslip.library import GaitLibrary
from aslip.network.runner.load import load
from aslip.network.runner.supervisor import Reading, Request, Stage, Supervisor
from aslip.robot import CASSIE
from aslip.transforms import DIRECTION_TABLE
from tests.control.helpers import altered, estimate, standing_packet


@pytest.fixture(scope="module")
def controller(library: GaitLibrary) -> Controller:
    return Controller("straight", library)


@pytest.fixture(scope="module")
def file(controller: Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "aslip.onnx"
    export_policy("straight", path, controller.library)
    return path


@pytest.fixture(scope="module")
def exported(file: Path) -> ExportedController:
    return ExportedController(file)


@pytest.fixture(scope="module")
def trace(exported: ExportedController) -> dict[str, np.ndarray]:
    return exported.contract.golden_trace()


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


def test_the_last_estimate_holds_while_none_comes(
    controller: Controller, exported: ExportedController, trace: dict[str, np.ndarray]
) -> None:
    row = estimate(trace["estimate"][0])
    theirs, ours = controller.start(row, 3.0), exported.start(row, 3.0)
    _, expected = controller.step(theirs, None)
    _, found = exported.step(ours, None)
    np.testing.assert_allclose(found, expected.numpy(), rtol=0, atol=TOLERANCE)
    # the state that a step was given stays the same
    np.testing.assert_array_equal(exported.step(ours, None)[1], found)


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
        # held in a step, as an estimate that does not come
        _, held = exported.step(exported.start(good), lost)
        np.testing.assert_array_equal(held, exported.step(exported.start(good), None)[1])
    with pytest.raises(ShapeError, match="must come from 1 robots, got 2"):
        exported.start(np.zeros((2, 1, 42)))
    assert not exported.stands
    assert "stand" not in exported.start(good, stand=0.0).entries
    with pytest.raises(ConfigurationError, match="cannot stand"):
        exported.start(good, stand=1.0)
    with pytest.raises(ConfigurationError, match="got packets, but the robots started with esti"):
        exported.step(exported.start(good), np.zeros((1, 1, 42)))


# ------------------------------------------------------------------------- contract


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
    wrong["target"][150, 3] += 3e-6
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


# ------------------------------------------------------------------------- damage


def test_damaged_files_are_refused(file: Path, tmp_path: Path) -> None:
    data, other = file.read_bytes(), tmp_path / "other.onnx"
    for cut in (0, 10, 5000, len(data) - 1):
        other.write_bytes(data[:cut])
        with pytest.raises(FileDamagedError, match="truncated, or no exported policy"):
            ExportedController(other)
    for place in (0, len(data) // 2, len(data) - 1):
        other.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        with pytest.raises(FileDamagedError, match="altered since its export"):
            ExportedController(other)
    other.write_bytes(seal(b"no model"))
    with pytest.raises(FileDamagedError, match="not an intact exported policy"):
        ExportedController(other)
    with pytest.raises(AssetError, match="there is no exported policy"):
        ExportedController(tmp_path / "none.onnx")


def test_files_that_point_elsewhere_or_need_foreign_code_are_refused(
    file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.onnx"
    model = onnx.load_from_string(file.read_bytes())
    foreign = onnx.load_from_string(file.read_bytes())
    onnx.external_data_helper.set_external_data(model.graph.initializer[0], "elsewhere.bin")
    other.write_bytes(seal(model.SerializeToString()))
    with pytest.raises(FileDamagedError, match="points to data in another file"):
        ExportedController(other)
    foreign.graph.node[0].domain = "someone"
    foreign.opset_import.add(domain="someone", version=1)
    other.write_bytes(seal(foreign.SerializeToString()))
    with pytest.raises(FileDamagedError, match="someone"):
        ExportedController(other)


def _metadata_faults(file: Path, trace: dict[str, np.ndarray]) -> Iterator[dict[str, str]]:
    """Entries that a file with the right hash may have."""
    metadata = ExportedController(file).contract.metadata
    about, interface = json.loads(metadata["aslip"]), json.loads(metadata["interface"])
    for value in ({k: v for k, v in about.items() if k != "robot"}, {**about, "robot": 3}, []):
        yield {"aslip": json.dumps(value)}
    other_type = [{**interface["inputs"][0], "dtype": "x"}, *interface["inputs"][1:]]
    for change in ({"inputs": None}, {"inputs": other_type}, {"feedback": None}):
        yield {"interface": json.dumps({**interface, **change})}
    yield {"interface": json.dumps({**interface, "feedback": {"x": "y"}})}
    yield {"interface": "null"}
    for pose in ("1,2", "nan" + 9 * ",0"):
        yield {"default_joint_pos": pose}
    data = base64.b64decode(metadata["golden_trace"])
    encrypted = bytearray(data)
    encrypted[data.index(b"PK\x01\x02") + 8] |= 1
    for content in (data[:99] + b"x" + data[100:], bytes(encrypted)):
        yield {"golden_trace": base64.b64encode(content).decode()}
    for name, value in (
        ("target", trace["target"][:, :1]),
        ("target", trace["target"] * np.nan),
        ("target", trace["target"].astype("U9")),
        ("estimate", trace["estimate"][:, :5]),
    ):
        yield {"golden_trace": trace_text({**trace, name: value})}


def test_files_of_wrong_content_are_damaged_files(
    file: Path, trace: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Their hashes are right."""
    for change in _metadata_faults(file, trace):
        other = altered(file, tmp_path / "other.onnx", **change)
        with pytest.raises(FileDamagedError, match=r"other\.onnx"):
            ExportedController(other).verify()


def _graph_fault(name: str, graph: onnx.GraphProto) -> None:
    """Add a node, or replace a weight."""
    made, one = onnx.helper, graph.input[0].name
    if name == "not finite":
        weights = max((a for a in graph.initializer if a.data_type == 1), key=lambda a: a.dims[:])
        weights.raw_data = weights.raw_data[:-4] + np.float32(np.inf).tobytes()
    elif name == "sparse tensor":
        parts = [made.make_tensor(n, k, [1], [0]) for n, k in (("s", 1), ("i", 7))]
        graph.sparse_initializer.append(made.make_sparse_tensor(*parts, [2**29]))
    elif name == "with a graph":
        empty = made.make_graph([], "empty", [], [graph.input[0]])
        node = made.make_node("If", [one], ["if"], then_branch=empty, else_branch=empty)
        graph.node.append(node)
    elif name == "Expand":
        graph.initializer.append(made.make_tensor("size", 7, [2], [2**15, 2**15]))
        graph.node.append(made.make_node("Expand", [one, "size"], ["large"]))
        graph.node.append(made.make_node("ReduceMax", ["large"], ["small"]))
    else:  # one after the other
        graph.initializer.append(made.make_tensor("size", 7, [2], [1000, 1000]))
        graph.node.append(made.make_node("Expand", [one, "size"], ["m0"]))
        for i in range(300):
            graph.node.append(made.make_node("MatMul", [f"m{i}", "m0"], [f"m{i + 1}"]))
        graph.node.append(made.make_node("ReduceMax", ["m300"], ["small"]))
    if graph.node[-1].op_type == "ReduceMax":
        target = next(node for node in graph.node if "motor_target" in node.output)
        target.output[:] = ["before"]
        graph.node.append(made.make_node("Cast", ["small"], ["cast"], to=1))
        graph.node.append(made.make_node("Add", ["before", "cast"], ["motor_target"]))


@pytest.mark.parametrize(
    "name", ["not finite", "sparse tensor", "with a graph", "Expand", "terminate flag"]
)
def test_graphs_without_bounds_are_refused(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Each would take gigabytes or minutes."""
    monkeypatch.setattr("aslip.control.exported_file._PATIENCE", 0.1)
    model, other = onnx.load_from_string(file.read_bytes()), tmp_path / "other.onnx"
    _graph_fault(name, model.graph)
    del model.metadata_props[-1]
    other.write_bytes(seal(model.SerializeToString()))
    start = time.monotonic()
    with pytest.raises(FileDamagedError, match=name):
        ExportedController(other)
    assert time.monotonic() - start < 2.0


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


# ------------------------------------------------------------------------- imports

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
