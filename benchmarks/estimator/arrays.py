"""Arrays out of tensordicts."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase

from aslip.robot import CASSIE


def packets(td: TensorDictBase) -> np.ndarray:
    """(n, w, 42) the sensors' packets, after noise."""
    return np.concatenate([array(td, ("sensors", name)) for name in CASSIE.packet_sizes], axis=-1)


def array(td: TensorDictBase, key: Any) -> np.ndarray:
    """An entry, in double precision if it is of numbers."""
    value = cast("torch.Tensor", td[key])
    return value.double().numpy() if value.is_floating_point() else value.numpy()
