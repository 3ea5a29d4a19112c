"""Exported policies that are damaged, forged or without bounds are refused."""

import base64
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest

from aslip.control.contract import seal, trace_text
from aslip.control.exported import ExportedController
from aslip.errors import AssetError, FileDamagedError
from tests.control.helpers import altered


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
