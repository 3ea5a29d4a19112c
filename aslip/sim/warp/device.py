"""Devices for simulations on MuJoCo Warp."""

from __future__ import annotations

import torch

from aslip.base.imports import extras
from aslip.errors import ConfigurationError

# captured solvers need conditional nodes of graphs
_LEAST_DRIVER: tuple[int, ...] = (12, 4)


def check_device(device: str | torch.device) -> torch.device:
    """Device of this name, if it can simulate.

    Raises:
        ConfigurationError: there is no such device, or its driver is too old.
        MissingExtraError: MuJoCo Warp is not installed.
    """
    with extras():
        import mujoco_warp  # noqa: F401
        import warp as wp
    kind, _, number = str(device).partition(":")
    if kind == "cpu":
        return torch.device("cpu")
    if kind != "cuda" or not (number or "0").isdecimal():
        raise ConfigurationError(f"device must be 'cuda' or 'cpu', got {str(device)!r}")
    if not torch.cuda.is_available():
        raise ConfigurationError(
            f"no GPU for device {str(device)!r}: torch {torch.__version__} finds none; take"
            " device='cpu', which is for tests, or backend='batch'"
        )
    wp.init()
    driver: tuple[int, ...] = wp.get_cuda_driver_version() or (0, 0)
    if driver < _LEAST_DRIVER:
        raise ConfigurationError(
            f"the GPU's driver knows CUDA {'.'.join(map(str, driver))}; physics needs one of"
            f" {'.'.join(map(str, _LEAST_DRIVER))} or newer"
        )
    if (index := int(number or 0)) >= (count := torch.cuda.device_count()):
        raise ConfigurationError(f"no GPU {str(device)!r}: there are {count}, from 'cuda:0' on")
    return torch.device("cuda", index)
