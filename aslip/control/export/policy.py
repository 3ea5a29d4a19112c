"""Export of the whole policy step: from estimates to motor targets, with its contract."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

import aslip
from aslip.base.archive import as_json
from aslip.base.assets import user_path
from aslip.base.decorators import on_cpu_in_single
from aslip.base.writing import replacing
from aslip.control.contract import (
    CONTRACT_VERSION,
    NODE,
    csv,
    describe_robot,
    external_data,
    seal,
    trace_text,
)
from aslip.control.controller import Controller
from aslip.control.estimates import split_estimate
from aslip.control.export.golden import golden_trace, random_commands, random_estimates
from aslip.control.export.graph import PolicyStep, trace_graph
from aslip.control.exported import ExportedController
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary, WalkMode
from aslip.policy import entry_names, find_policy, read_card

_BATCH = 1000  # steps that PyTorch computes at once in a comparison


@on_cpu_in_single
def export_policy(
    policy: str | Path | Controller,
    path: str | Path,
    library: GaitLibrary | None = None,
    *,
    check: Callable[[ExportedController], None] | None = None,
) -> ExportedController:
    """Export a policy with everything that is needed to run it, and verify its golden trace.

    The graph is the policy step of `aslip.Controller` for a robot that estimates its own state:
    clock, reference with its tables, feedforward, observation, normaliser, network, motor targets.
    The entries of the file besides the graph are those of `aslip.control.contract`.

    Args:
        policy: name of a shipped policy, a policy file, or a controller with a policy of your own.
        path: file to write; an existing one is replaced atomically.
        library: gaits; by default the shipped ones of the policy's stack. A controller has its own.
        check: called with a controller from the verified file before that replaces an existing one,
            which stays if the check raises.

    Returns:
        Controller from the file.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy cannot be traced, observes entries that a robot does not
            estimate itself, or its action is not a delta that is added to angles.
        FileDamagedError: the file does not repeat its golden trace; an existing one stays.
        OSError: the file cannot be written; an existing one stays intact.
    """
    name = policy if isinstance(policy, str | Path) else type(policy.policy).__name__
    controller = Controller(policy, library) if isinstance(policy, str | Path) else policy
    step = PolicyStep(controller)
    model = trace_graph(step, step.inputs, step.outputs)
    metadata = {
        **mjlab_metadata(controller, str(name)),
        "leapp": json.dumps(_interface(step)),
        "aslip": json.dumps(_about(controller, policy)),
        "golden_trace": trace_text(golden_trace(controller)),
    }
    robot = controller.estimator.robot

    def verify(file: Path) -> None:
        exported = ExportedController(file, robot)
        exported.verify()
        if check is not None:
            check(exported)

    write_model(model, metadata, user_path(path), verify)
    return ExportedController(path, robot)


def write_pipeline(exported: ExportedController, path: Path) -> None:
    """Write the pipeline file with which LEAPP runs an exported policy, in JSON, which is YAML.

    Args:
        exported: the exported policy.
        path: file to write, `.yaml`, in the folder of the policy.
    """
    data, interface = exported.path.read_bytes(), exported.contract.interface
    parameters = {
        "model_path": exported.path.name,
        "backend": "onnx",
        "md5sum": hashlib.md5(data, usedforsecurity=False).hexdigest(),
        "sha256sum": hashlib.sha256(data).hexdigest(),
    }
    models = {NODE: {**interface["models"][NODE], "parameters": parameters}}
    with replacing(user_path(path)) as file:
        file.write(as_json({**interface, "models": models, "system information": {}}))


def mjlab_metadata(controller: Controller, run_path: str) -> dict[str, str]:
    """Metadata with the keys of mjlab, in full precision.

    mjlab's actions are added to constant angles. Here the angles move: `default_joint_pos` has
    those of the reference at phase 0 and zero command, or of standing if the policy can stand, and
    the entry `aslip` names the baseline.
    """
    robot = controller.estimator.robot
    return {
        "run_path": run_path,
        "joint_names": csv(robot.motor_names),
        "joint_stiffness": csv(robot.stiffness),
        "joint_damping": csv(robot.damping),
        "default_joint_pos": csv(controller.steering.pose().tolist()),
        "command_names": csv(["command", *(["stand"] if controller.steering.stands else [])]),
        "observation_names": csv(entry_names(controller.observation)),
        "action_scale": csv([1.0] * len(robot.motor_names)),
    }


def write_model(
    model: onnx.ModelProto,
    metadata: Mapping[str, str],
    path: Path,
    check: Callable[[Path], None] | None = None,
) -> None:
    """Write a model with metadata and its hash to one file.

    Args:
        model: the model.
        metadata: text by key.
        path: file to write.
        check: called with the complete temporary file; an existing file stays if it raises.

    Raises:
        ConfigurationError: the metadata contain the word by which ONNX points to other files.
        OSError: the file cannot be written; an existing one stays intact.
    """
    model.producer_name, model.producer_version = "aslip", aslip.__version__
    onnx.helper.set_model_props(model, dict(metadata))
    data = model.SerializeToString(deterministic=True)
    if external_data(data):
        raise ConfigurationError(
            "names and metadata of a policy must not contain the word 'location', by which ONNX"
            " points to other files"
        )
    with replacing(path) as file:
        file.write(seal(data))
        if check is not None:
            file.flush()
            check(Path(file.name))


def _interface(step: PolicyStep) -> dict[str, Any]:
    """Inputs, outputs and feedback in the terms of LEAPP's pipeline files."""
    inputs, outputs = step.inputs, step.outputs
    fed_back = set(step.feedback.values())
    return {
        "models": {
            NODE: {
                "inputs": [entry.describe() for entry in inputs],
                "outputs": [entry.describe() for entry in outputs],
            }
        },
        "pipeline": {
            "data_flow": {},
            "feedback_flow": {f"{NODE}/{a}": [f"{NODE}/{b}"] for a, b in step.feedback.items()},
            "inputs": {NODE: [entry.name for entry in inputs if entry.name not in fed_back]},
            "outputs": {NODE: [entry.name for entry in outputs]},
        },
    }


def _about(controller: Controller, policy: str | Path | Controller) -> dict[str, Any]:
    """Entry `aslip`: robot, library, policy, baseline, rates and versions."""
    robot, library = controller.estimator.robot, controller.library
    file = find_policy(policy) if isinstance(policy, str | Path) else None
    card = {} if file is None else read_card(file)
    return {
        "contract": CONTRACT_VERSION,
        "aslip": aslip.__version__,
        "torch": torch.__version__,
        "robot": describe_robot(robot),
        "library": {
            "sha256": library.sha256,
            "axes": [axis.tolist() for axis in library.table.axes],
            "made_by": library.made_by,
        },
        "policy": {
            "sha256": None if file is None else hashlib.sha256(file.read_bytes()).hexdigest(),
            "network": card.get("network"),
            "stack": card.get("stack"),
        },
        "baseline": entry_names([controller.baseline])[0],
        "policy_period": robot.policy_period,
        "motor_lead": controller.motor_lead,
        "command_rates": controller.command_rates if library.command_size > 1 else None,
    }


@on_cpu_in_single
def compare(
    exported: ExportedController,
    controller: Controller,
    samples: int = 100_000,
    *,
    seed: int = 1,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> float:
    """Compare an exported policy with PyTorch at random states.

    Args:
        exported: the exported policy.
        controller: controller from which it was exported.
        samples: number of policy steps.
        seed: seed of the states.
        progress: wrapper of the loop over batches, such as `tqdm.tqdm`.

    Returns:
        Largest difference of a motor target [rad]; NaN if a target is.
    """
    step, generator = PolicyStep(controller), np.random.default_rng(seed)
    names = [entry.name for entry in step.outputs]
    target, largest = names.index("motor_target"), 0.0
    for begin in progress(range(0, samples, _BATCH)):
        values = _random_inputs(step, min(_BATCH, samples - begin), controller, generator)
        with torch.no_grad():
            expected = step(*values)[target].numpy()
        for i, row in enumerate(expected):
            feed = {
                entry.name: value[i : i + 1].numpy()
                for entry, value in zip(step.inputs, values, strict=True)
            }
            found = exported.outputs(feed)["motor_target"]
            # unlike Python's max, it keeps NaN
            largest = float(np.maximum(largest, np.abs(found - row).max()))
    return largest


def _random_inputs(
    step: PolicyStep, num: int, controller: Controller, generator: np.random.Generator
) -> tuple[torch.Tensor, ...]:
    """Inputs (n, k) of robots in random states near the reference."""
    library, robot = controller.library, controller.estimator.robot
    command = random_commands(library, num, generator)
    phase = torch.from_numpy(generator.random((num, 1), dtype=np.float32))
    rows = random_estimates(library, robot, phase, command, generator)
    given = {name: torch.from_numpy(value) for name, value in split_estimate(rows, robot).items()}
    given |= {"command": torch.from_numpy(command), "last_phase": phase}
    given["last_heading"] = torch.from_numpy(generator.normal(0, 0.3, (num, 1)))
    given["first"] = torch.from_numpy(generator.random((num, 1)) < 0.1)
    given["position"] = torch.from_numpy(generator.normal(0, 0.2, (num, 3)))
    for name, count in (("stand", 2), ("last_mode", len(WalkMode))):
        given[name] = torch.from_numpy(generator.integers(0, count, (num, 1)).astype(np.float32))
    for entry in step.inputs:
        if entry.name not in given:
            shape = (num, *entry.value.shape[1:])
            noise = generator.normal(0, 0.2, shape).astype(np.float32)
            given[entry.name] = torch.from_numpy(noise)
    return tuple(given[entry.name] for entry in step.inputs)
