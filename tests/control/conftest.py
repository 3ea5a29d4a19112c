"""The shipped policy for straight walks under a controller, and exported."""

from pathlib import Path

import numpy as np
import pytest

from aslip.control import Controller
from aslip.control.export import export_policy
from aslip.control.exported import ExportedController
from aslip.library import GaitLibrary


@pytest.fixture(scope="session")
def controller(library: GaitLibrary) -> Controller:
    """Controller of the policy."""
    return Controller("straight", library)


@pytest.fixture(scope="session")
def file(controller: Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of the exported policy."""
    path = tmp_path_factory.mktemp("exported") / "aslip.onnx"
    export_policy("straight", path, controller.library)
    return path


@pytest.fixture(scope="session")
def exported(file: Path) -> ExportedController:
    """Controller from the file."""
    return ExportedController(file)


@pytest.fixture(scope="session")
def trace(exported: ExportedController) -> dict[str, np.ndarray]:
    """Golden trace in the file."""
    return exported.contract.golden_trace()
