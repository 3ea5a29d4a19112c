"""Controllers that turn sensor packets into motor targets, on a robot and in simulation.

`python -m aslip.control` runs a controller over the robot's network protocol.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.control.controller import Controller, ControllerState
    from aslip.control.path import Eight, PathFollower

__all__ = ["Controller", "ControllerState", "Eight", "PathFollower"]

# the runner works without PyTorch, which `controller` imports
__getattr__, __dir__ = attach(
    __name__,
    {
        "controller": ["Controller", "ControllerState"],
        "path": ["Eight", "PathFollower"],
    },
)
