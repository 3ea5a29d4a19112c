"""Opening of exported policies: checks of file, graph, contract and library; needs no PyTorch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aslip.control.contract import Contract, damaged, observed_name, read_sealed, wrong
from aslip.control.own_estimate import split_estimate
from aslip.imports import extras
from aslip.robot import Robot

with extras():
    import onnxruntime


def open_policy(path: Path, robot: Robot) -> tuple[onnxruntime.InferenceSession, Contract]:
    """Session and contract of a file, checked against the robot and each other."""
    data = read_sealed(path)
    options = onnxruntime.SessionOptions()
    # one robot's network is too small for several threads
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        contract = Contract.of(session.get_modelmeta().custom_metadata_map)
        difference = contract.difference(robot)
    except Exception as error:  # onnxruntime's errors have no common class
        raise damaged(path, str(error).splitlines()[0]) from error
    if difference is not None:
        raise wrong(path, difference)
    for kind, described, found in (
        ("inputs", contract.inputs, session.get_inputs()),
        ("outputs", contract.outputs, session.get_outputs()),
    ):
        has = [(entry["name"], *entry["shape"]) for entry in described]
        is_ = [(entry.name, *entry.shape) for entry in found]
        if has != is_:
            odd: Any = sorted(set(has) ^ set(is_)) or f"order {[n for n, *_ in is_]}"
            raise damaged(path, f"{kind} of its graph differ from its contract: {odd}")
    return session, contract


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
