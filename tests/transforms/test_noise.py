"""Sensor noise has the levels and correlations of its settings, and follows seeds.

Statistics are compared within 5 standard errors of the estimate, with fixed seeds.
"""

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import lfilter
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.robot import CASSIE
from aslip.sim.sensors import JOINT_VELOCITY_FILTER
from aslip.transforms import NoiseLevel, ObservationNoise
from aslip.transforms.noise import BIAS_TIME
from tests.helpers import differing, leaves, seeded

WINDOW = 10
SIZES = CASSIE.noise_channels | {"orientation": 4}
SILENT = dict.fromkeys(CASSIE.noise_channels, NoiseLevel())


def _clean(num: int, window: int = WINDOW, seed: int = 7) -> TensorDict:
    """Arbitrary packets of a robot."""
    generator = torch.Generator().manual_seed(seed)
    sensors = {
        name: torch.randn(num, window, size, generator=generator) for name, size in SIZES.items()
    }
    unit = torch.nn.functional.normalize(sensors["orientation"], dim=-1)
    sensors["orientation"] = torch.where(unit[..., :1] < 0, -unit, unit)
    return TensorDict(sensors=TensorDict(sensors, batch_size=num), batch_size=num)


def _noise(*levels: Any, **settings: Any) -> ObservationNoise:
    return seeded(ObservationNoise(*levels, **settings))


def _start(noise: ObservationNoise, packets: TensorDict) -> TensorDictBase:
    """The packets after a reset of all robots."""
    return noise._reset(TensorDict(batch_size=packets.batch_size), packets.clone())


def _next(noise: ObservationNoise, td: TensorDictBase, packets: TensorDict) -> TensorDictBase:
    """The packets after a step."""
    return noise._step(td, packets.clone())


def _errors(noisy: TensorDictBase, clean: TensorDict) -> dict[str, Tensor]:
    """Errors (n, W, k) of each sensor in double precision; rotation vectors for orientations."""
    errors = {}
    for name in CASSIE.noise_channels:
        before, after = (td["sensors", name].double() for td in (clean, noisy))
        errors[name] = _turn(before, after) if name == "orientation" else after - before
    return errors


def _turn(before: Tensor, after: Tensor) -> Tensor:
    """Rotation vector, in the frame of `before`, from one orientation to another."""
    w, v = before[..., :1], -before[..., 1:]
    scalar, vector = after[..., :1], after[..., 1:]
    real = w * scalar - (v * vector).sum(-1, keepdim=True)
    imaginary = w * vector + scalar * v + torch.linalg.cross(v, vector)
    sine = imaginary.norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, real.abs())
    return torch.where(sine > 0, angle / sine * imaginary * real.sign(), 0.0)


def _norm(vector: Tensor) -> Tensor:
    return torch.linalg.vector_norm(vector, dim=-1)


def _join(by_sensor: dict[str, Tensor]) -> Tensor:
    return torch.cat([by_sensor[name] for name in CASSIE.noise_channels], dim=-1)


def _bias(td: TensorDictBase) -> Tensor:
    """Biases (n, 41) of all sensors."""
    return torch.cat([td["sensor_bias", name] for name in CASSIE.noise_channels], dim=-1)


def _everywhere(white: float = 0.0, bias: float = 0.0) -> dict[str, NoiseLevel]:
    return dict.fromkeys(CASSIE.noise_channels, NoiseLevel(white, bias))


# ------------------------------------------------------------- white noise


def test_every_channel_has_its_own_white_noise() -> None:
    """The standard deviation is as set (relative error 1 / sqrt(2 N)) and the mean zero."""
    levels, num = {}, 500
    for name, channels in CASSIE.noise_channels.items():
        levels[name] = NoiseLevel(white=0.01 + 0.01 * np.arange(channels))
    clean = _clean(num)
    errors = _errors(_start(_noise(levels), clean), clean)
    for name, error in errors.items():
        samples = error.flatten(0, 1)
        count, expected = len(samples), torch.tensor(levels[name].white)
        assert ((samples.std(0) / expected - 1).abs() < 5 / math.sqrt(2 * count)).all(), name
        assert ((samples.mean(0) / expected).abs() < 5 / math.sqrt(count)).all(), name


def test_white_noise_is_independent_across_packets_channels_robots_and_steps() -> None:
    """Correlations vanish, standard error 1 / sqrt(N)."""
    num = 400
    clean = _clean(num)
    noise = _noise(_everywhere(white=1e-2))
    first = _start(noise, clean)
    a, b = (_join(_errors(td, clean)) / 1e-2 for td in (first, _next(noise, first, clean)))
    for x, y in (
        (a[:, 1:], a[:, :-1]),
        (a[..., 1:], a[..., :-1]),
        (a[1:], a[:-1]),
        (a, b),
    ):
        assert abs((x * y).mean()) < 5 / math.sqrt(x.numel())


# ------------------------------------------------------------------- bias


def test_the_packets_of_a_step_share_a_bias_which_is_reported() -> None:
    clean = _clean(5)
    noise = _noise(_everywhere(bias=0.2))
    td = _start(noise, clean)
    for _ in range(2):
        for name, error in _errors(td, clean).items():
            bias = td["sensor_bias", name].double()[:, None].expand_as(error)
            torch.testing.assert_close(error, bias, rtol=0, atol=2e-6, msg=name)
        td = _next(noise, td, clean)


@pytest.mark.parametrize("steps", [1, 333])
def test_the_bias_is_stationary_with_the_given_correlation_time(steps: int) -> None:
    """N values: std within 5 / sqrt(2 N), correlation r over t/tau within 5 (1 - r^2) / sqrt(N)."""
    num, level = 500, 0.3
    clean = _clean(num, window=1)
    noise = _noise(_everywhere(bias=level))
    td = first = _start(noise, clean)
    for _ in range(steps):
        td = _next(noise, td, clean)
    start, end = _bias(first).double() / level, _bias(td).double() / level
    count = start.numel()
    for value in (start, end):
        assert abs(value.mean()) < 5 / math.sqrt(count)
        assert abs(value.std() - 1) < 5 / math.sqrt(2 * count)
    expected = math.exp(-steps * CASSIE.policy_period / BIAS_TIME)
    tolerance = 5 * (1 - expected**2) / math.sqrt(count)
    correlation = torch.corrcoef(torch.stack([start.flatten(), end.flatten()]))[0, 1]
    assert abs(correlation - expected) < tolerance


def test_the_bias_drifts_from_the_one_in_the_tensordict() -> None:
    """The transform keeps no state: it steps two episodes in alternation."""
    clean = _clean(3)
    noise = _noise(_everywhere(bias=1.0))
    one, other = _start(noise, clean), _start(noise, clean)
    for _ in range(3):
        after_one, after_other = _next(noise, one, clean), _next(noise, other, clean)
        for before, after in ((one, after_one), (other, after_other)):
            assert (_bias(after) - _bias(before)).abs().max() < 0.5
        one, other = after_one, after_other
    assert (_bias(one) - _bias(other)).abs().max() > 1.0


# ------------------------------------------------------------ orientation


@pytest.mark.parametrize("axis", range(3))
def test_errors_of_the_orientation_are_in_the_pelvis_frame(axis: int) -> None:
    level = np.zeros(3)
    level[axis] = 0.3
    clean = _clean(200)
    noise = _noise({**SILENT, "orientation": NoiseLevel(white=level, bias=level)})
    error = _errors(_start(noise, clean), clean)["orientation"]
    others = [i for i in range(3) if i != axis]
    assert error[..., others].abs().max() < 2e-6
    assert error[..., axis].abs().max() > 0.5


def test_the_orientation_stays_a_unit_quaternion_with_w_of_0_or_more() -> None:
    """Also near w = 0, where noise would change the sign of w."""
    clean = _clean(200)
    clean["sensors", "orientation"] = torch.tensor([1e-4, 0.6, 0.0, 0.8]).expand(200, WINDOW, 4)
    noise = _noise({"orientation": NoiseLevel(white=0.1, bias=0.1)})
    after = _start(noise, clean)["sensors", "orientation"]
    assert (after[..., 0] >= 0).all()
    assert (after[..., 1] < 0).any()  # noise has changed the sign of some w
    torch.testing.assert_close(_norm(after), torch.ones(200, WINDOW), rtol=0, atol=2e-7)


# ------------------------------------------------------- none, and scales


def test_without_noise_the_packets_are_bit_equal() -> None:
    noise = _noise(SILENT)
    clean = _clean(4)
    td = _start(noise, clean)
    for _ in range(2):
        for name in SIZES:
            assert torch.equal(td["sensors", name], clean["sensors", name]), name
            assert (td["sensor_bias", name] == 0).all()
        td = _next(noise, td, clean)


def test_channels_without_noise_are_bit_equal() -> None:
    """By default, motors and foot encoders have no noise."""
    clean = _clean(4)
    noisy = _start(_noise(), clean)
    changed = {name: noisy["sensors", name] != clean["sensors", name] for name in SIZES}
    for name in ("motor_position", "motor_velocity"):
        assert not changed[name].any(), name
    for name in ("joint_position", "joint_velocity"):
        assert changed[name].any(1).any(0).tolist() == [True, True, False] * 2, name
    for name in ("orientation", "gyro", "accelerometer"):
        assert changed[name].any(-1).all(), name


def test_nan_stays_in_its_packet() -> None:
    clean = _clean(3)
    broken = clean.clone()
    for name in SIZES:
        broken["sensors", name][1, 4] = torch.nan
    noisy = {}
    for packets in (clean, broken):
        noise = _noise(_everywhere(0.1, 0.1))
        noisy[packets is broken] = _next(noise, _start(noise, packets), packets)
    for name in SIZES:
        value = noisy[True]["sensors", name]
        assert value[1, 4].isnan().all(), name
        expected = noisy[False]["sensors", name].clone()
        expected[1, 4] = torch.nan
        torch.testing.assert_close(value, expected, rtol=0, atol=0, equal_nan=True)
    assert torch.equal(_bias(noisy[True]), _bias(noisy[False]))


# ------------------------------------------------------------------ seeds


def _two_steps(noise: ObservationNoise) -> TensorDictBase:
    td = _start(noise, _clean(4))
    return _next(noise, td, _clean(4))


def test_the_same_seed_gives_the_same_noise() -> None:
    noise, other = _noise(), _noise()
    noise.set_seed(3)
    other.set_seed(3)
    torch.manual_seed(1)  # the transform must not depend on it
    first = _two_steps(noise)
    assert not differing(first, _two_steps(other))
    assert differing(first, _two_steps(other))
    other.set_seed(3)
    assert not differing(first, _two_steps(other))
    other.set_seed(4)
    after = _two_steps(other)
    assert not torch.equal(after["sensors", "gyro"], first["sensors", "gyro"])


def test_draws_of_a_sensor_do_not_depend_on_other_levels() -> None:
    alone = _noise({**SILENT, "gyro": CASSIE.sensor_noise["gyro"]})
    among, single = _two_steps(_noise()), _two_steps(alone)
    for group in ("sensors", "sensor_bias"):
        assert torch.equal(among[group, "gyro"], single[group, "gyro"])


def test_a_partial_reset_draws_for_the_rows_that_are_reset_only() -> None:
    """TorchRL keeps the other rows, as `test_command.py` tests."""
    clean, rows, new = _clean(4), torch.tensor([[False], [True], [False], [True]]), [1, 3]
    noise = _noise(_everywhere(0.1, 0.1))
    td = _next(noise, _start(noise, clean), clean)
    after = noise._reset(td.clone().set("_reset", rows), clean.clone())
    for key, value in leaves(td.select("sensors", "sensor_bias")).items():
        # at level 0.1, no draw is close to the previous one in all channels
        assert _norm((after[key][new] - value[new]).flatten(1)).min() > 1e-2, key
    other = _noise(_everywhere(0.1, 0.1))
    _next(other, _start(other, clean), clean)
    alone = other._reset(TensorDict(batch_size=2), clean[new].clone())
    assert torch.equal(_bias(after)[new], _bias(alone))


def test_noise_of_joint_velocities_is_that_of_the_filtered_encoders() -> None:
    angle, rate = (
        np.asarray(CASSIE.sensor_noise[f"joint_{name}"].white) for name in ("position", "velocity")
    )
    noise = np.random.default_rng(0).normal(size=(400_000, len(angle))) * angle
    filtered = np.asarray(lfilter(*JOINT_VELOCITY_FILTER, noise, axis=0))[1000:]
    np.testing.assert_allclose(rate, filtered.std(0), rtol=0.01)
    packets = filtered[:: CASSIE.packet_substeps, 0]
    # white enough for independent draws per packet
    assert abs(np.corrcoef(packets[1:], packets[:-1])[0, 1]) < 0.1


def test_given_levels_replace_only_those_of_their_sensors() -> None:
    noise = ObservationNoise({"gyro": NoiseLevel(0.1)})
    assert noise.levels == {**CASSIE.sensor_noise, "gyro": NoiseLevel(0.1)}


def test_a_level_has_its_own_memory() -> None:
    values = np.array([1.0, 2.0, 3.0])
    level = NoiseLevel(white=values)
    values[0] = 9.0
    assert level == NoiseLevel(white=(1.0, 2.0, 3.0))


@pytest.mark.parametrize("value", [math.nan, [0.1, -0.1], "0.1", [[0.1], [0.1, 0.2]]])
def test_a_negative_or_infinite_standard_deviation_is_refused(value: Any) -> None:
    with pytest.raises(ConfigurationError, match="bias must be finite and 0 or more, got"):
        NoiseLevel(bias=value)


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="no sensor 'gyros', did you mean 'gyro'"):
        ObservationNoise({"gyros": NoiseLevel()})
    with pytest.raises(UnknownNameError, match=r"no sensor 'sonar'; there are.*'accelerometer'"):
        ObservationNoise({"sonar": NoiseLevel()})
    with pytest.raises(ConfigurationError, match="bias of 'gyro' must be one number or 3"):
        ObservationNoise({"gyro": NoiseLevel(bias=[0.1] * 4)})
