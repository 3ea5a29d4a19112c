"""State estimator on a device: packets, memory and estimates are tensors.

Its Kalman filters are the code of `aslip.estimation.filter`, compiled by Warp. A thread updates one
robot, in double precision.
"""

from __future__ import annotations

import functools
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aslip.estimation import FilterNoise, StateEstimator
from aslip.estimation import filter as code
from aslip.robot import CASSIE, Robot
from aslip.sim.warp.functions import device_function

wp.set_module_options({"enable_backward": False})

_Number = wp.float64
_Flags = wp.array[wp.bool]
_Vector, _Matrix = wp.array[_Number], wp.array2d[_Number]


@wp.struct
class Settings:
    """Numbers of the filter; see `aslip.estimation.filter`."""

    walk: _Matrix
    timestep: _Number
    radius: _Number
    rock_height: _Number
    shock: _Number
    leg: _Number
    ground: _Number
    gate: _Number
    load: _Number
    unload: _Number
    patience: _Number
    surprise: _Number
    surprise_height: _Number
    half_square: _Number
    zero: _Number
    one: _Number
    nothing: _Number


# types of a robot's arrays, and of an axis'
_ROBOT = {
    "mean": _Matrix, "cov": wp.array3d[_Number], "half_sole": _Matrix, "loaded": _Flags,
    "resting": _Flags, "adrift": _Vector, "innovation": _Matrix, "acceleration": _Vector,
    "doubt": _Number, "sole": _Matrix, "half": _Matrix, "load": _Vector, "fresh": _Flags,
    "settings": Settings, "gain": _Vector,
}  # fmt: skip
_AXIS = _ROBOT | {"column": int, "sole": _Vector, "squared": _Vector}
_AXIS |= dict.fromkeys(("lowest", "leg", "variance"), _Number)
_ROW = {"x": _Vector, "p": _Matrix}

_update = device_function(
    code._update, _ROW | {"gain": _Vector, "variance": _Number, "innovation": _Number}
)
_step_robot = device_function(
    code._step_robot,
    _ROBOT,
    _predict=device_function(code._predict, _ROBOT),
    _near_ground=device_function(code._near_ground, _AXIS),
    _is_at_rest=device_function(code._is_at_rest, _AXIS),
    _correct=device_function(code._correct, _AXIS, _update=_update),
    _ground=device_function(code._ground, _AXIS | _ROW, _update=_update),
    _plant=device_function(code._plant, _AXIS),
)


@wp.kernel
def _step_robots(
    mean: wp.array3d[_Number],
    covariance: wp.array4d[_Number],
    half_sole: wp.array3d[_Number],
    loaded: wp.array2d[wp.bool],
    resting: wp.array2d[wp.bool],
    adrift: wp.array2d[_Number],
    innovation: wp.array3d[_Number],
    acceleration: wp.array2d[_Number],
    doubt: wp.array[_Number],
    sole: wp.array3d[_Number],
    half: wp.array3d[_Number],
    load: wp.array2d[_Number],
    fresh: wp.array2d[wp.bool],
    settings: Settings,
    gain: wp.array2d[_Number],
):
    i = wp.tid()
    _step_robot(
        mean[i], covariance[i], half_sole[i], loaded[i], resting[i], adrift[i], innovation[i],
        acceleration[i], doubt[i], sole[i], half[i], load[i], fresh[i], settings, gain[i],
    )  # fmt: skip


class DeviceEstimator(StateEstimator):
    """State estimator of robots on a device; see `StateEstimator`.

    Args:
        device: device of the packets, such as "cuda" or "cpu".
        robot: robot that sends the packets.
        noise: noise that the filter assumes.
    """

    takes_tensors = True

    def __init__(
        self,
        device: str | torch.device,
        robot: Robot = CASSIE,
        noise: FilterNoise | None = None,
    ) -> None:
        wp.init()
        super().__init__(robot, noise, functools.partial(torch.as_tensor, device=device))
        self._filter.compiled = step


@functools.lru_cache(maxsize=8)
def _on_device(numbers: tuple[Any, ...], device: str) -> Settings:
    settings = Settings()
    for name, value in numbers:
        array = isinstance(value, tuple)
        value = wp.array(value, dtype=_Number, device=device) if array else value
        setattr(settings, name, value)
    return settings


def step(*arrays: Tensor | Any) -> None:
    """Update n robots with one packet, in place.

    Args:
        arrays: those of the CPU's function, as tensors of one device; then the settings.
    """
    *tensors, settings = arrays
    device = wp.device_from_torch(tensors[0].device)
    numbers = tuple(
        (name, tuple(map(tuple, value)) if name == "walk" else float(value))
        for name, value in settings._asdict().items()
    )
    num = len(tensors[0])
    tensors[5] = tensors[5][:, None]  # a view, as the code writes it
    tensors[8] = tensors[8].double()
    gain = torch.empty(num, 5, dtype=torch.float64, device=tensors[0].device)
    inputs = [wp.from_torch(tensor, return_ctype=True) for tensor in tensors]
    inputs += [_on_device(numbers, str(device)), wp.from_torch(gain, return_ctype=True)]
    stream = wp.stream_from_torch(tensors[0].device) if device.is_cuda else None
    wp.launch(_step_robots, dim=num, inputs=inputs, device=device, stream=stream)
