"""Export of the whole policy step: from estimates to motor targets, with its contract."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import onnx
import torch

import aslip
from aslip.base.assets import user_path
from aslip.base.checks import check_count
from aslip.base.decorators import on_cpu_in_single
from aslip.base.writing import replacing
from aslip.control.contract import (
    CONTRACT_VERSION,
    csv,
    describe_robot,
    external_data,
    seal,
    trace_text,
)
from aslip.control.controller import Controller
from aslip.control.export.golden import golden_trace
from aslip.control.export.graph import PolicyStep, trace_graph
from aslip.control.exported import ExportedController
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import entry_names, find_policy, read_card


@on_cpu_in_single
def export_policy(
    policy: str | Path | Controller,
    path: str | Path,
    library: GaitLibrary | None = None,
    *,
    steps: int = 0,
) -> ExportedController:
    """Export a policy with everything that is needed to run it, and verify its golden trace.

    The graph is the policy step of `aslip.Controller` for a robot that estimates its own state:
    clock, reference with its tables, feedforward, observation, normaliser, network, motor targets.
    The entries of the file besides the graph are those of `aslip.control.contract`.

    Args:
        policy: name of a shipped policy, a policy file, or a controller with a policy of your own.
        path: file to write; an existing one is replaced atomically.
        library: gaits; by default the shipped ones of the policy's stack. A controller has its own.
        steps: number of further policy steps on which the file must agree with PyTorch.

    Returns:
        Controller from the file.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy cannot be traced, follows a planner, observes entries that a
            robot does not estimate itself, or its action is not a delta that is added to angles.
        FileDamagedError: the file does not repeat its golden trace, or the further steps; an
            existing one stays.
        OSError: the file cannot be written; an existing one stays intact.
    """
    check_count("steps", steps, least=0)
    name = policy if isinstance(policy, str | Path) else type(policy.policy).__name__
    controller = Controller(policy, library) if isinstance(policy, str | Path) else policy
    if controller.plans:
        raise ConfigurationError(
            f"the policy {str(name)!r} follows a planner, which an exported file does not have;"
            " aslip.Controller runs both"
        )
    step = PolicyStep(controller)
    model = trace_graph(step, step.inputs, step.outputs)
    metadata = {
        **_mjlab_metadata(controller, str(name)),
        "interface": json.dumps(_interface(step)),
        "aslip": json.dumps(_about(controller, policy)),
        "golden_trace": trace_text(golden_trace(controller)),
    }
    robot = controller.robot

    def verify(file: Path) -> None:
        exported = ExportedController(file, robot)
        exported.verify()
        if steps:
            exported.verify(golden_trace(controller, steps, seed=1))

    _write(model, metadata, user_path(path), verify)
    return ExportedController(path, robot)


def _mjlab_metadata(controller: Controller, run_path: str) -> dict[str, str]:
    """Metadata with the keys of mjlab, in full precision.

    mjlab's actions are added to constant angles. Here the angles move: `default_joint_pos` has
    those of the reference at phase 0 and zero command, or of standing if the policy can stand, and
    the entry `aslip` names the baseline.
    """
    robot = controller.robot
    return {
        "run_path": run_path,
        "joint_names": csv(robot.motor_names),
        "joint_stiffness": csv(robot.stiffness),
        "joint_damping": csv(robot.damping),
        "default_joint_pos": csv(controller.pose.tolist()),
        "command_names": csv(["command", *(["stand"] if controller.stands else [])]),
        "observation_names": csv(entry_names(controller.observation)),
        "action_scale": csv([1.0] * len(robot.motor_names)),
    }


def _write(
    model: onnx.ModelProto, metadata: Mapping[str, str], path: Path, check: Callable[[Path], None]
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
        file.flush()
        check(Path(file.name))


def _interface(step: PolicyStep) -> dict[str, Any]:
    """Inputs, outputs and feedback of the graph."""
    return {
        "inputs": [entry.describe() for entry in step.inputs],
        "outputs": [entry.describe() for entry in step.outputs],
        "feedback": step.feedback,
    }


def _about(controller: Controller, policy: str | Path | Controller) -> dict[str, Any]:
    """Entry `aslip`: robot, library, policy, baseline, rates and versions."""
    robot, library = controller.robot, controller.library
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
