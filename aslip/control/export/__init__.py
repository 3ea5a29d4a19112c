"""Export of policies to ONNX; only the export needs PyTorch and onnx, not the exported policy.

`python -m aslip.control.export` exports from the command line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.control.export.network import export_network
    from aslip.control.export.policy import compare, export_policy, write_pipeline

__all__ = ["compare", "export_network", "export_policy", "write_pipeline"]

__getattr__, __dir__ = attach(
    __name__,
    {
        "network": ["export_network"],
        "policy": ["compare", "export_policy", "write_pipeline"],
    },
)
