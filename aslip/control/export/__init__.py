"""Export of policies to ONNX; only the export needs PyTorch and onnx, not the exported policy.

`python -m aslip.control.export` exports from the command line.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
