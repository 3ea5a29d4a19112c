"""Opening of exported policies: checks of file, graph, contract and library; needs no PyTorch.

A forged file can still move the robot in any way, but the graph neither runs without end nor takes
memory without bound: it has no loops, and its intermediate values share 64 MiB.
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aslip.base.imports import extras
from aslip.control.contract import Contract, damaged, explained, observed_name, read_sealed, wrong
from aslip.control.estimates import split_estimate, standing_estimate
from aslip.robot import Robot

with extras():
    import onnxruntime

TYPES = {"float32": np.float32, "float64": np.float64, "bool": np.bool_}
"""Types of inputs and outputs of a graph."""

# memory for the intermediate values of all graphs in this process [bytes]; ours take below 4 MiB
_MEMORY = 2**26
# longest duration of the first run [s]; ours take 1 ms
_PATIENCE = 10.0
# fields of ONNX's messages in Protocol Buffers
_GRAPH, _FUNCTIONS, _TRAINING = 7, 25, 20
_NODES, _INITIALIZERS, _SPARSE_INITIALIZERS = 1, 5, 15
_OPERATOR, _ATTRIBUTES, _DOMAIN = 4, 5, 7
_TENSOR, _SUBGRAPHS, _TENSORS, _SPARSE_TENSORS = 5, (6, 11), 10, (22, 23)
_KIND, _RAW_DATA = 2, 9
# field or kind of the numbers of a tensor -> NumPy's type
_NUMBERS = {4: "<f4", 10: "<f8"}
_RAW_NUMBERS = {1: "<f4", 10: "<f2", 11: "<f8"}


def open_policy(path: Path, robot: Robot) -> tuple[onnxruntime.InferenceSession, Contract]:
    """Session and contract of a file, checked against the robot and each other."""
    data = read_sealed(path)
    with explained(path):
        check_graph(data)
        session = _session(data)
        contract = Contract.of(session.get_modelmeta().custom_metadata_map)
        difference = contract.difference(robot)
    if difference is not None:
        raise wrong(path, difference)
    with explained(path):
        for kind, described, found in (
            ("inputs", contract.inputs, session.get_inputs()),
            ("outputs", contract.outputs, session.get_outputs()),
        ):
            has = [(entry["name"], *entry["shape"]) for entry in described]
            is_ = [(entry.name, *entry.shape) for entry in found]
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
    place = onnxruntime.OrtMemoryInfo("Cpu", kinds[0].ORT_ARENA_ALLOCATOR, 0, kinds[1].DEFAULT)
    # the last three: grow as needed, default sizes
    arena = onnxruntime.OrtArenaCfg(_MEMORY, 1, -1, -1)
    onnxruntime.create_and_register_allocator(place, arena)


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


def check_graph(model: bytes) -> None:
    """Check that a serialised ONNX model has only plain operators, and finite weights.

    Raises:
        ValueError: it has a loop, a branch, a function or a sparse tensor, each of which can take
            any time or memory; an operator of another domain; or an array with a number that is
            not finite.
    """
    for field, value in _fields(memoryview(model)):
        if field in (_FUNCTIONS, _TRAINING):
            raise ValueError("it has functions of its own")
        if field == _GRAPH:
            _check_nodes(value)


def _check_nodes(graph: Any) -> None:
    """Check nodes and weights of a serialised graph."""
    for field, value in _fields(graph):
        if field == _SPARSE_INITIALIZERS:
            raise ValueError("it has sparse tensors")
        if field == _INITIALIZERS:
            _check_finite(value)
        if field != _NODES:
            continue
        node = list(_fields(value))
        operator = b"".join(bytes(v) for f, v in node if f == _OPERATOR).decode()
        if domain := b"".join(bytes(v) for f, v in node if f == _DOMAIN).decode():
            raise ValueError(f"it has an operator {operator!r} of {domain!r}, beyond ONNX's own")
        for attribute in (list(_fields(v)) for f, v in node if f == _ATTRIBUTES):
            found = {f for f, _ in attribute}
            if found & {*_SUBGRAPHS, *_SPARSE_TENSORS}:
                raise ValueError(f"it has an operator {operator!r} with a graph or a sparse tensor")
            for f, v in attribute:
                if f in (_TENSOR, _TENSORS):
                    _check_finite(v)


def _check_finite(tensor: Any) -> None:
    """Check the numbers of a serialised tensor; single constants may be infinite."""
    fields = list(_fields(tensor))
    # of several, the last one counts
    raw = next((_RAW_NUMBERS.get(v) for f, v in reversed(fields) if f == _KIND), None)
    for field, kind in {**_NUMBERS, _RAW_DATA: raw}.items():
        parts = [v for f, v in fields if f == field]
        numbers = np.concatenate([np.frombuffer(v, kind) for v in parts]) if parts and kind else [0]
        if len(numbers) > 1 and not np.isfinite(numbers).all():
            raise ValueError("it has weights that are not finite")


def _fields(message: Any) -> Iterator[tuple[int, Any]]:
    """Fields of a message of Protocol Buffers: number, and an integer or the bytes.

    Raises:
        ValueError: the message is damaged.
    """
    place, sizes = 0, {1: 8, 5: 4}
    while place < len(message):
        key, place = _integer(message, place)
        kind = key & 7
        if kind == 0:
            value, place = _integer(message, place)
        elif kind == 2 or kind in sizes:
            size, place = (sizes[kind], place) if kind in sizes else _integer(message, place)
            value, place = message[place : place + size], place + size
        else:
            raise ValueError("it is no ONNX model")
        if place > len(message):
            raise ValueError("it is no ONNX model")
        yield key >> 3, value


def _integer(message: Any, place: int) -> tuple[int, int]:
    """Integer of variable length at a place, and the place after it."""
    value = 0
    for i, byte in enumerate(message[place : place + 10]):
        value |= (byte & 127) << 7 * i
        if byte < 128:
            return value, place + i + 1
    raise ValueError("it is no ONNX model")


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


def library_sha256(library: str, robot: Robot) -> str:
    """SHA-256 of a library by name, file or SHA-256."""
    if len(library) == 64 and set(library) <= set("0123456789abcdef"):
        return library
    # imported late: it imports PyTorch
    from aslip.library import GaitLibrary

    return GaitLibrary.load(library, robot).sha256


def check_order(
    entries: Mapping[str, np.ndarray], observation_names: Sequence[str], robot: Robot
) -> None:
    """Check that the observation has the entries of the contract in its order.

    Args:
        entries: outputs (1, k) of the graph.
        observation_names: names of the observation's entries, in order.
        robot: robot that gives the sizes of an estimate.

    Raises:
        ValueError: an entry is missing, or at another place.
    """
    parts = split_estimate(entries["estimate"], robot)
    named = {**entries, **{f"estimate/{name}": part for name, part in parts.items()}}
    place, observation = 0, entries["observation"]
    for name in map(observed_name, observation_names):
        if name not in named:
            raise ValueError(f"no output is named {name!r}, an entry of the observation")
        end = place + named[name].shape[1]
        if not np.array_equal(observation[:, place:end], named[name]):
            raise ValueError(
                f"numbers {place} to {end - 1} of the observation are not {name!r}, as the"
                " contract says"
            )
        place = end
    if place != observation.shape[1]:
        raise ValueError(
            f"the contract names {place} of {observation.shape[1]} numbers of the observation"
        )
