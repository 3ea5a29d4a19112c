"""Loading of controllers by the name or file of their policy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from aslip.control.base import ControllerBase, Packets
from aslip.control.estimates import standing_estimate
from aslip.errors import AslipError, ConfigurationError
from aslip.robot import CASSIE

_WARM_UP = 5


class Loaded(NamedTuple):
    """Controller and its files."""

    controller: ControllerBase[Any]
    """Controller, warmed up."""
    files: dict[str, bytes]
    """Contents of the files that `load` read, by name."""


def load(policy: str | Path, library: str | Path | None = None) -> Loaded:
    """Load a controller, and take some steps so that the first one on the robot is fast.

    An exported policy, a file that ends with ".onnx", needs no PyTorch; its golden trace is
    verified first.

    Args:
        policy: name of a shipped policy, policy file, folder of a training run, or exported policy.
        library: gait library of the policy: file, or name of a shipped one; by default the one that
            `aslip.policy.policy_library` finds. An exported policy contains its library.

    Raises:
        AssetError, FileDamagedError: there is no such policy or library, or it is damaged.
        ConfigurationError: policy and library, or policy and robot, do not fit; or a library is
            given for an exported policy.
    """
    exported = Path(policy).suffix == ".onnx"
    loaded = _of_export(policy, library) if exported else _of_torch(policy, library)
    try:
        warm_up(loaded.controller)
    except Exception as error:  # networks fail in many ways
        reason = str(error) if isinstance(error, AslipError) else f"{type(error).__name__}: {error}"
        raise ConfigurationError(
            f"the policy {str(policy)!r} and the library {str(library or 'of its gaits')!r} do not"
            f" fit: {reason}"
        ) from error
    return loaded


def warm_up(controller: ControllerBase[Any]) -> None:
    """Take some steps as of a standing robot, and check the motor targets.

    Raises:
        ConfigurationError: the targets are not ten finite angles.
    """
    # the estimator takes a robot without readings for one that stands
    lost = np.full(CASSIE.packet_size, np.nan)
    given: Packets = lost if controller.plans else standing_estimate()
    state = controller.start(given, 0.0, heading=0.0)
    for _ in range(_WARM_UP):
        state, _ = controller.step(state, given, None)
    target = np.asarray(state.motor_target)
    if target.size != len(CASSIE.motor_names) or not np.isfinite(target).all():
        raise ConfigurationError(f"its motor targets are not ten finite angles: {target.tolist()}")


def _of_export(policy: str | Path, library: str | Path | None) -> Loaded:
    """Controller of an exported policy."""
    # imported late: other policies run without onnxruntime
    from aslip.control.exported import ExportedController

    if library is not None:
        raise ConfigurationError(
            f"the exported policy {str(policy)!r} contains its library; give none, got {library!r}"
        )
    controller = ExportedController(policy)
    controller.verify()
    return Loaded(controller, {"policy.onnx": controller.path.read_bytes()})


def _of_torch(policy: str | Path, library: str | Path | None) -> Loaded:
    """Controller of a policy file."""
    # imported late: an exported policy runs without PyTorch
    import torch

    from aslip.control.controller import Controller
    from aslip.library.library import library_file
    from aslip.policy import find_policy, policy_library

    # one robot: more threads only cost time
    torch.set_num_threads(1)
    path = find_policy(policy)
    controller = Controller(path, policy_library(path, library))
    file = library_file(controller.library.name)
    return Loaded(controller, {"policy.zip": path.read_bytes(), "library.npz": file.read_bytes()})
