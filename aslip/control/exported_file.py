"""Opening of exported policies: checks of file, graph and contract; needs no PyTorch.

A forged file can still move the robot in any way, but the graph neither runs without end nor takes
memory without bound: it has no loops, and its intermediate values share 64 MiB.
"""

from __future__ import annotations

import functools
import math
import threading
from pathlib import Path
from typing import Any

import numpy as np

from aslip.base.imports import extras
from aslip.control.contract import Contract, damaged, explained, read_sealed, wrong
from aslip.control.estimates import standing_estimate
from aslip.robot import Robot

with extras():
    import onnx
    import onnx.numpy_helper
    import onnxruntime

TYPES = {"float32": np.float32, "float64": np.float64, "bool": np.bool_}
"""Types of inputs and outputs of a graph."""

# memory for the intermediate values of all graphs in this process [bytes]; ours take below 4 MiB
_MEMORY = 2**26
# longest duration of the first run [s]; ours take 1 ms
_PATIENCE = 10.0
_FLOATS = (onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16, onnx.TensorProto.DOUBLE)


def open_policy(path: Path, robot: Robot) -> tuple[onnxruntime.InferenceSession, Contract]:
    """Session and contract of a file, checked against the robot and each other."""
    data = read_sealed(path)
    with explained(path):
        check_graph(onnx.load_from_string(data))
        session = _session(data)
        contract = Contract.of(session.get_modelmeta().custom_metadata_map)
        difference = contract.difference(robot)
    if difference is not None:
        raise wrong(path, difference)
    with explained(path):
        for kind, described, actual in (
            ("inputs", contract.inputs, session.get_inputs()),
            ("outputs", contract.outputs, session.get_outputs()),
        ):
            has = [(entry["name"], *entry["shape"]) for entry in described]
            is_ = [(entry.name, *entry.shape) for entry in actual]
            if has != is_:
                unexpected: Any = sorted(set(has) ^ set(is_)) or f"order {[n for n, *_ in is_]}"
                raise damaged(path, f"{kind} of its graph differ from its contract: {unexpected}")
        _run_once(session, contract)
    return session, contract


def _session(data: bytes) -> onnxruntime.InferenceSession:
    """Session of a serialised graph, on one thread and with bounded memory."""
    _reserve_memory()
    options = onnxruntime.SessionOptions()
    # one robot's network is too small for several threads
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.add_session_config_entry("session.use_env_allocators", "1")
    # weights are as large as the file
    options.add_session_config_entry("session.use_device_allocator_for_initializers", "1")
    return onnxruntime.InferenceSession(
        data,
        options,
        providers=["CPUExecutionProvider"],
        # it computes values in other memory; graphs of the exporter have nothing to fold
        disabled_optimizers=["ConstantFolding"],
    )


@functools.cache
def _reserve_memory() -> None:
    """Bound the memory that sessions of this process share; once per process."""
    kinds = onnxruntime.OrtAllocatorType, onnxruntime.OrtMemType
    memory = onnxruntime.OrtMemoryInfo("Cpu", kinds[0].ORT_ARENA_ALLOCATOR, 0, kinds[1].DEFAULT)
    # the last three: grow as needed, default sizes
    arena = onnxruntime.OrtArenaCfg(_MEMORY, 1, -1, -1)
    onnxruntime.create_and_register_allocator(memory, arena)


def _run_once(session: onnxruntime.InferenceSession, contract: Contract) -> None:
    """Run a graph with zeros; an exception is raised if that takes longer than 10 s."""
    if sum(math.prod(entry["shape"]) for entry in contract.inputs) > _MEMORY // 64:
        raise ValueError("its inputs are too large")
    zeros = {e["name"]: np.zeros(e["shape"], TYPES[e["dtype"]]) for e in contract.inputs}
    options = onnxruntime.RunOptions()
    timer = threading.Timer(_PATIENCE, setattr, (options, "terminate", True))
    timer.daemon = True
    timer.start()
    try:
        session.run(None, zeros, options)
    finally:
        timer.cancel()


def check_graph(model: onnx.ModelProto) -> None:
    """Check that an ONNX model has only plain operators, and finite weights.

    Raises:
        ValueError: it has a loop, a branch, a function or a sparse tensor, each of which can take
            any time or memory; an operator of another domain; or an array with a number that is
            not finite.
    """
    graph = model.graph
    if model.functions or model.training_info:
        raise ValueError("it has functions of its own")
    if graph.sparse_initializer:
        raise ValueError("it has sparse tensors")
    weights = list(graph.initializer)
    for node in graph.node:
        if node.domain:
            raise ValueError(
                f"it has an operator {node.op_type!r} of {node.domain!r}, beyond ONNX's own"
            )
        for entry in node.attribute:
            has = (entry.HasField("g"), entry.graphs, entry.HasField("sparse_tensor"))
            if any(has) or entry.sparse_tensors:
                raise ValueError(
                    f"it has an operator {node.op_type!r} with a graph or a sparse tensor"
                )
            weights += [entry.t, *entry.tensors]
    for weight in weights:
        # single constants may be infinite
        several = weight.data_type in _FLOATS and math.prod(weight.dims) > 1
        if several and not np.isfinite(onnx.numpy_helper.to_array(weight)).all():
            raise ValueError("it has weights that are not finite")


def try_steps(controller: Any) -> None:
    """Take two steps of an exported controller with the estimate of a standing robot.

    Raises:
        Exception: a step fails, or targets or pose are not finite angles of all motors.
    """
    estimate, size = standing_estimate(controller.robot), len(controller.robot.motor_names)
    first = controller.start(estimate)
    for state in (first, controller.step(first, estimate)[0]):
        for angles in (state.motor_target, controller.pose[None]):
            if angles.shape != (1, size) or not np.isfinite(angles).all():
                raise ValueError(f"its pose or its motor targets are not {size} finite angles")
