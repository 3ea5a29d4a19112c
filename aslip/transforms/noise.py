"""Sensor noise: white noise and drifting bias on the packets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.robot import CASSIE, NoiseLevel
from aslip.transforms.base import SeededTransform, extend_spec, require_keys
from aslip.transforms.rotation import from_vector, multiply, upper_hemisphere

BIAS_TIME: Final = 10.0
"""Time constant of the bias [s]."""

_SENSOR_KEYS = tuple(("sensors", name) for name in CASSIE.noise_channels)
_FACTOR_KEY = ("dynamics", "sensor_noise")
_BIAS_KEYS = tuple(("sensor_bias", name) for name in CASSIE.noise_channels)


class ObservationNoise(SeededTransform):
    r"""Add noise to the packets `("sensors", name)`, each (n, W, k).

    Every packet has its own white noise; the W packets of a policy step share a bias. The bias is
    drawn at each reset and drifts from step to step (Ornstein-Uhlenbeck process, exact over the
    policy period):

    .. math:: b \leftarrow e^{-\Delta t / \tau}\,b + \sigma_b \sqrt{1 - e^{-2 \Delta t / \tau}}\,\xi

    The tensordict holds the bias as `("sensor_bias", name)` (n, k), in the sensor's unit. Noise on
    the orientation is a rotation vector in the pelvis frame, k = 3 [rad]; the result is a unit
    quaternion with w >= 0. Sensors of zero level stay bit-equal, and the draws of one sensor do not
    depend on the levels of others. NaN stays NaN and does not spread to other packets.

    If `RandomDynamics` draws `("dynamics", "sensor_noise")`, it is a factor on each robot's noise;
    `("sensor_bias", name)` is the bias before that factor.

    Must come before the transforms that read the packets. A step reads the bias of the previous
    step, so a caller who builds tensordicts by hand must copy it.

    Args:
        levels: sensor -> level, which replaces that of `Robot.sensor_noise`.

    Raises:
        UnknownNameError: a level is for a sensor that the robot lacks.
        ConfigurationError: a level lacks one value per channel.
    """

    needs_env = "it draws biases at resets, and each robot keeps its own"

    @on_cpu_in_single
    def __init__(self, levels: Mapping[str, NoiseLevel] | None = None) -> None:
        super().__init__(in_keys=_SENSOR_KEYS, out_keys=[*_SENSOR_KEYS, *_BIAS_KEYS])
        self.levels = dict(CASSIE.sensor_noise) | _checked(levels or {})
        self._decay = math.exp(-CASSIE.policy_period / BIAS_TIME)
        self._renewal = math.sqrt(-math.expm1(-2 * CASSIE.policy_period / BIAS_TIME))
        # settings, so not stored in checkpoints
        self._levels: dict[str, tuple[Tensor, Tensor]] = {}
        for sensor, channels in CASSIE.noise_channels.items():
            level = self.levels[sensor]
            white, bias = (_row(value, channels) for value in (level.white, level.bias))
            if white.any() or bias.any():
                self._levels[sensor] = white, bias

    @on_cpu_in_single
    def set_seed(self, seed: int) -> None:
        """Seed the generators: one for each sensor at resets, and one for each sensor at steps.

        So the draws of a sensor do not depend on the levels of another, and those of a step do not
        depend on whether another robot was reset before.
        """
        super().set_seed(seed)
        seeds = torch.randint(2**62, (2, len(CASSIE.noise_channels)), generator=self.generator)
        self._of_steps, self._of_resets = (
            {
                sensor: torch.Generator(self.place).manual_seed(value)
                for sensor, value in zip(CASSIE.noise_channels, row, strict=True)
            }
            for row in seeds.tolist()
        )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        if mask is None or mask.all():
            return self._begin(tensordict_reset)
        # TorchRL uses only the rows of reset robots
        rows = mask.reshape(tensordict_reset.batch_size)
        some = tensordict_reset.select(*self.in_keys, _FACTOR_KEY, strict=False)[rows]
        chosen = self._begin(some.clone())
        for key in self.out_keys:
            value = cast("Tensor", chosen[key])
            full = torch.zeros(*tensordict_reset.batch_size, *value.shape[1:], dtype=value.dtype)
            full[rows] = value
            tensordict_reset.set(key, full)
        return tensordict_reset

    def _begin(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw biases, and make the packets noisy."""
        for sensor, channels in CASSIE.noise_channels.items():
            drawn = torch.zeros(*tensordict.batch_size, channels, dtype=torch.float32)
            if sensor in self._levels:
                drawn = self._levels[sensor][1] * _normal(drawn.shape, self._of_resets[sensor])
            tensordict.set(("sensor_bias", sensor), drawn)
        return self._add_noise(tensordict, self._of_resets)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in _BIAS_KEYS:
            bias, sensor = cast("Tensor", tensordict[key]), key[1]
            if sensor in self._levels:
                fresh = self._levels[sensor][1] * _normal(bias.shape, self._of_steps[sensor])
                bias = self._decay * bias + self._renewal * fresh
            next_tensordict.set(key, bias)
        return self._add_noise(next_tensordict, self._of_steps)

    def _add_noise(
        self, tensordict: TensorDictBase, generators: Mapping[str, torch.Generator]
    ) -> TensorDictBase:
        """Add the given biases and white noise to the packets."""
        factor = tensordict.get(_FACTOR_KEY, None)
        for sensor, (white, _) in self._levels.items():
            packets = cast("Tensor", tensordict["sensors", sensor])
            shape = (*packets.shape[:-1], len(white))
            bias = cast("Tensor", tensordict["sensor_bias", sensor])
            error = white * _normal(shape, generators[sensor]) + bias.unsqueeze(-2)
            if factor is not None:
                error = factor.unsqueeze(-2) * error
            turns = sensor == "orientation"
            noisy = _turned(packets, error) if turns else packets + error
            tensordict.set(("sensors", sensor), noisy)
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the biases."""
        require_keys(self, observation_spec, self.in_keys)
        sizes = dict(zip(_BIAS_KEYS, CASSIE.noise_channels.values(), strict=True))
        return extend_spec(observation_spec, sizes)


def _checked(levels: Mapping[str, NoiseLevel]) -> dict[str, NoiseLevel]:
    """Levels by sensor, checked: known sensors, with one value or one for each channel."""
    for sensor, level in levels.items():
        if sensor not in CASSIE.noise_channels:
            raise UnknownNameError.among("sensor", sensor, CASSIE.noise_channels)
        if not isinstance(level, NoiseLevel):
            raise ConfigurationError(f"the level of {sensor!r} must be a NoiseLevel, got {level!r}")
        for name in ("white", "bias"):
            value, channels = getattr(level, name), CASSIE.noise_channels[sensor]
            if isinstance(value, tuple) and len(value) != channels:
                raise ConfigurationError(
                    f"{name} of {sensor!r} must be one number or {channels}, got the"
                    f" {len(value)} of {value!r}"
                )
    return dict(levels)


def _normal(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """Independent standard normal numbers."""
    return torch.randn(*shape, generator=generator, dtype=torch.float32)


def _row(value: Any, channels: int) -> Tensor:
    """(channels,) values, of one for all channels or one for each."""
    return torch.tensor(value, dtype=torch.float32).expand(channels)


def _turned(quaternion: Tensor, rotation: Tensor) -> Tensor:
    """Orientations (*b, 4), rotated by vectors (*b, 3) [rad] in their own frames."""
    turned = multiply(quaternion, from_vector(rotation))
    return upper_hemisphere(torch.nn.functional.normalize(turned, dim=-1))
