"""Controllers: from sensor packets to motor targets, on a robot as in simulation."""

from aslip.control.controller import Controller, ControllerState

__all__ = ["Controller", "ControllerState"]
