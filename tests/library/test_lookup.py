"""Look-ups: exact at samples, smooth between them, consistent with the robot."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import copy
import math
import pickle
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from aslip.errors import ShapeError, SpeedOutOfRangeError
from aslip.library import GaitLibrary, Reference
from aslip.robot import CASSIE, SIDES
from aslip.robot.model import load_model

from .bent import symmetric_library

NAMES = [field.name for field in fields(Reference)]
FEET = ("left_foot", "right_foot")
MIRROR = torch.tensor([1.0, -1.0, 1.0])


def _column(value: float | Tensor, like: Tensor | None = None) -> Tensor:
    if like is not None:
        return torch.full_like(like, float(value))
    return torch.as_tensor(value, dtype=torch.float64).reshape(-1, 1)


def _random(num: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    draw = torch.rand(2, num, 1, generator=generator, dtype=torch.float64)
    return draw[0], 2 * draw[1]


def _phase_grid(num: int = 400) -> Tensor:
    return _column(torch.arange(num, dtype=torch.float64) / num)


@pytest.mark.parametrize("row", [0, 7, 20, "turning"])
def test_lookup_at_samples_returns_the_table(library: GaitLibrary, row: int | str) -> None:
    library, gait = (symmetric_library(), 5) if isinstance(row, str) else (library, row)
    samples = library.table.motor_position.shape[1]
    phase = _column(torch.arange(samples, dtype=torch.float64) / samples)
    command = torch.tensor(library.table.commands[gait])
    reference = library.lookup(phase, command.expand(samples, -1))
    for name in NAMES:
        side, _, kind = name.partition("_")
        rows = getattr(library.table, kind if side in SIDES else name)[gait]
        rows = rows[:, SIDES.index(side)] if side in SIDES else rows
        expected = torch.tensor(rows.reshape(samples, -1)).float()
        torch.testing.assert_close(getattr(reference, name), expected, rtol=0, atol=1e-6)


def test_lookup_is_periodic_in_phase(library: GaitLibrary) -> None:
    phase, speed = _random(100)
    for turns in (-2.0, 1.0, 3.0):
        a, b = library.lookup(phase, speed), library.lookup(phase + turns, speed)
        for name in NAMES:
            torch.testing.assert_close(getattr(a, name), getattr(b, name), rtol=0, atol=1e-6)
    zero, one = library.lookup(0 * phase, speed), library.lookup(0 * phase + 1, speed)
    for name in NAMES:
        torch.testing.assert_close(getattr(zero, name), getattr(one, name), rtol=0, atol=0)


@pytest.mark.parametrize("tiny", [1e-17, 1e-12, 1e-9])
def test_reference_is_continuous_at_the_wrap_and_at_samples(
    library: GaitLibrary, tiny: float
) -> None:
    """One-sided limits are equal, also for phases that round to a whole stride."""
    for node in (0.0, 1.0, 64 / 128):
        speed = _column(torch.tensor([0.0, 0.55, 2.0]))
        below = library.lookup(torch.full_like(speed, node - tiny), speed)
        above = library.lookup(torch.full_like(speed, node + tiny), speed)
        for name in NAMES:
            torch.testing.assert_close(
                getattr(below, name), getattr(above, name), rtol=0, atol=1e-5
            )


LARGEST_CHANGES = {"velocity": (0.2, 0.02), "torque": (8.0, 1.0)}
"""Largest changes of velocities and torques over 1/1000 of a stride, and over 1 mm/s of speed."""


def test_reference_changes_little_over_small_steps_of_phase_and_speed(library: GaitLibrary) -> None:
    """The library has no outliers."""
    phase, speed = _random(2000)
    here = library.lookup(phase, speed)
    ahead = library.lookup(phase + 1e-3, speed)
    faster = library.lookup(phase, (speed + 1e-3).clamp(max=2.0))
    for name in NAMES:
        value = getattr(here, name)
        by_phase, by_speed = LARGEST_CHANGES.get(name.split("_")[-1], (0.02, 0.005))
        by_phase *= 2 if name == "motor_velocity" else 1
        assert (getattr(ahead, name) - value).abs().max() < by_phase, name
        assert (getattr(faster, name) - value).abs().max() < by_speed, name


def test_derivative_in_phase_is_continuous(library: GaitLibrary) -> None:
    """The reference is once continuously differentiable, also across samples and the wrap."""
    step = 1e-6
    samples = library.table.qpos.shape[1]
    for column in (0, 1, 40, 127):
        for speed in (0.0, 0.55, 2.0):
            node, v = _column(column / samples), _column(speed)
            before, at, after = (
                library.initial_state(p, v)[0] for p in (node - step, node, node + step)
            )
            left, right = (at - before) / step, (after - at) / step
            # the tolerance is the second derivative times the step
            torch.testing.assert_close(left, right, rtol=0, atol=2e-3)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,)])
def test_lookup_accepts_any_batch_shape(library: GaitLibrary, shape: tuple[int, ...]) -> None:
    phase, speed = torch.rand(*shape, 1), 2 * torch.rand(*shape, 1)
    reference = library.lookup(phase, speed)
    for name in NAMES:
        value = getattr(reference, name)
        size = {"motor": 10, "body_heading": 1, "left_foot_heading": 1, "right_foot_heading": 1}
        assert value.shape == (*shape, size.get(name, size.get(name.split("_")[0], 3)))
        assert value.dtype == torch.float32
    qpos, qvel = library.initial_state(phase, speed)
    assert qpos.shape == (*shape, 35)
    assert qvel.shape == (*shape, 32)
    assert qpos.dtype == qvel.dtype == torch.float64
    assert library.stride(speed).shape == speed.shape


def test_lookup_of_a_batch_equals_single_lookups(library: GaitLibrary) -> None:
    phase, speed = _random(20)
    many = library.lookup(phase, speed)
    for i in range(20):
        one = library.lookup(phase[i], speed[i])
        for name in NAMES:
            torch.testing.assert_close(getattr(one, name), getattr(many, name)[i], rtol=0, atol=0)


@pytest.mark.parametrize(("outside", "bound"), [(-0.5, 0.0), (2.5, 2.0), (1e6, 2.0)])
def test_speeds_outside_are_clamped(library: GaitLibrary, outside: float, bound: float) -> None:
    """Commands out of range have the reference of the nearest command in range."""
    phase, _ = _random(20)
    a, b = (library.lookup(phase, _column(v, phase)) for v in (outside, bound))
    for name in NAMES:
        torch.testing.assert_close(getattr(a, name), getattr(b, name), rtol=0, atol=0)
    stride = library.stride(_column(outside, phase))
    torch.testing.assert_close(stride, library.stride(_column(bound, phase)), rtol=0, atol=0)


@pytest.mark.parametrize("speed", [-0.01, 2.01, math.nan, math.inf])
def test_check_command_names_value_and_range(library: GaitLibrary, speed: float) -> None:
    with pytest.raises(SpeedOutOfRangeError, match=rf"{speed!r} m/s .*0 to 2 m/s"):
        library.check_command(speed)
    with pytest.raises(ValueError, match="gait library"):
        library.check_command(speed)


def test_commands_may_be_whole_numbers(library: GaitLibrary) -> None:
    whole = torch.tensor([[1], [9]])
    for function in (library.stride, library.nearest):
        assert torch.equal(function(whole), function(whole.float()))


def test_strides_are_linear_between_gaits(library: GaitLibrary) -> None:
    speeds = torch.tensor(library.speeds.copy())
    expected = torch.tensor([gait.stride for gait in library.gaits], dtype=torch.float64)
    torch.testing.assert_close(library.stride(speeds[:, None])[:, 0], expected, rtol=0, atol=1e-12)
    middle = library.stride((speeds[1:, None] + speeds[:-1, None]) / 2)[:, 0]
    torch.testing.assert_close(middle, (expected[1:] + expected[:-1]) / 2, rtol=1e-12, atol=0)
    assert library.stride(speeds[:, None].float()).dtype == torch.float32


# ------------------------------------------------------------- consistency


@pytest.mark.parametrize(("offset", "tolerance"), [(0.0, 0.02), (0.05, 0.05)])
def test_velocities_are_the_rates_of_positions(
    library: GaitLibrary, offset: float, tolerance: float
) -> None:
    """Body and feet over ground, to 0.02 m/s at gaits and 0.05 m/s half way between two."""
    step, phase = 1e-3, _phase_grid()
    for speed in library.speeds[:-1] + offset:
        v = _column(speed, phase)
        time = 2 * step * library.stride(v)
        here = library.lookup(phase, v)
        ahead, behind = library.lookup(phase + step, v), library.lookup(phase - step, v)
        uniform = torch.tensor([speed, 0.0, 0.0])
        body = (ahead.body_position - behind.body_position) / time + uniform
        torch.testing.assert_close(body.float(), here.body_velocity, rtol=0, atol=tolerance)
        for foot in FEET:
            moved = getattr(ahead, f"{foot}_position") - getattr(behind, f"{foot}_position")
            rate = (moved / time).float() + body.float()
            expected = getattr(here, f"{foot}_velocity")
            torch.testing.assert_close(rate, expected, rtol=0, atol=2 * tolerance)


def test_reference_half_a_stride_later_is_mirrored(library: GaitLibrary) -> None:
    """Positions and velocities half a stride apart are mirror images."""
    phase, speed = _random(300)
    now, later = library.lookup(phase, speed), library.lookup(phase + 0.5, speed)
    for kind in ("position", "velocity"):
        for name, twin in (("left_foot", "right_foot"), ("right_foot", "left_foot")):
            mirrored = getattr(now, f"{name}_{kind}") * MIRROR
            found = getattr(later, f"{twin}_{kind}")
            torch.testing.assert_close(found, mirrored, rtol=0, atol=2e-4)
        mirrored = getattr(now, f"body_{kind}") * MIRROR
        torch.testing.assert_close(getattr(later, f"body_{kind}"), mirrored, rtol=0, atol=2e-4)
    signs = torch.tensor([-1.0, -1, 1, 1, 1])
    left, right = now.motor_position.split(5, dim=-1)
    mirrored = torch.cat([signs * right, signs * left], dim=-1)
    torch.testing.assert_close(later.motor_position, mirrored, rtol=0, atol=2e-4)


def test_phase_zero_is_left_lift_off(library: GaitLibrary) -> None:
    """Just after phase 0 the left foot rises while the right foot stays down."""
    speed = _column(torch.tensor(library.speeds.copy()))
    before = library.lookup(torch.full_like(speed, -0.01), speed)
    after = library.lookup(torch.full_like(speed, 0.05), speed)
    assert before.left_foot_velocity.abs().max() < 0.02
    assert (after.left_foot_velocity[:, 2] > 0.05).all()
    assert after.right_foot_velocity.abs().max() < 1e-3


def test_one_foot_is_at_rest_on_the_ground_at_every_phase(library: GaitLibrary) -> None:
    """At least one foot is on the ground, at rest, at every phase of every gait."""
    phase, speed = _random(1000, seed=1)
    reference = library.lookup(phase, speed)
    heights = [
        (getattr(reference, f"{foot}_position") + reference.body_position)[:, 2] for foot in FEET
    ]
    speeds = [getattr(reference, f"{foot}_velocity").norm(dim=-1) for foot in FEET]
    assert torch.stack(heights).min(dim=0).values.abs().max() < 1e-3
    assert torch.stack(heights).min() > -1e-3
    assert torch.stack(speeds).min(dim=0).values.max() < 0.02


# ------------------------------------------------------------ the robot


def _loop_errors(qpos: Tensor) -> np.ndarray:
    """(n, 12) components of the gaps of the loops [m]."""
    model = load_model()
    data = mujoco.MjData(model)
    errors = []
    for row in qpos.numpy():
        data.qpos = row
        mujoco.mj_forward(model, data)
        errors.append(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY].copy())
    return np.array(errors)


@pytest.mark.parametrize(("offset", "tolerance"), [(0.0, 1e-6), (0.05, 5e-4)])
def test_initial_state_closes_the_loops(
    library: GaitLibrary, offset: float, tolerance: float
) -> None:
    """Gaps are below a micrometre at a gait's speed, and half a millimetre between two."""
    phase, _ = _random(20)
    for speed in library.speeds[:-1:4] + offset:
        qpos, _ = library.initial_state(phase, _column(speed, phase))
        errors = _loop_errors(qpos)
        assert errors.shape == (20, 12)
        assert np.abs(errors).max() < tolerance


@pytest.mark.parametrize(("offset", "tolerance"), [(0.0, 1e-5), (0.05, 5e-4)])
def test_initial_state_has_feet_and_pelvis_on_the_reference(
    library: GaitLibrary, offset: float, tolerance: float
) -> None:
    """Pelvis upright, toes forward and level (a leg cannot roll its foot); velocities as well."""
    model = load_model()
    data = mujoco.MjData(model)
    phase, _ = _random(20, seed=2)
    for speed in library.speeds[:-1:4] + offset:
        v = _column(speed, phase)
        reference = library.lookup(phase, v)
        qpos, qvel = library.initial_state(phase, v)
        for i in range(len(phase)):
            data.qpos, data.qvel = qpos[i].numpy(), qvel[i].numpy()
            mujoco.mj_forward(model, data)
            body = reference.body_position[i].numpy()
            np.testing.assert_allclose(data.qpos[:3], body, atol=tolerance)
            np.testing.assert_allclose(np.abs(data.qpos[3:7]), [1, 0, 0, 0], atol=1e-6)
            np.testing.assert_allclose(data.qvel[:3], reference.body_velocity[i], atol=1e-5)
            for foot in FEET:
                site = data.site(foot)
                expected = body + getattr(reference, f"{foot}_position")[i].numpy()
                np.testing.assert_allclose(site.xpos, expected, atol=tolerance)
                toes = site.xmat.reshape(3, 3)[:, 0]
                np.testing.assert_allclose(toes, [1, 0, 0], atol=20 * tolerance)
                velocity = data.sensor(f"{foot}_velocity").data
                expected = getattr(reference, f"{foot}_velocity")[i].numpy()
                np.testing.assert_allclose(velocity, expected, atol=100 * tolerance + 1e-3)


def test_initial_state_has_the_motor_angles_of_the_reference(library: GaitLibrary) -> None:
    phase, speed = _random(50, seed=3)
    qpos, _ = library.initial_state(phase, speed)
    motors = CASSIE.indices.motor_qpos.tolist()
    expected = library.lookup(phase, speed).motor_position
    torch.testing.assert_close(qpos[:, motors].float(), expected, rtol=0, atol=1e-6)


def test_initial_state_has_unit_quaternions(library: GaitLibrary) -> None:
    qpos, _ = library.initial_state(*_random(200))
    for start in (3, 10, 24):
        norm = qpos[:, start : start + 4].norm(dim=-1)
        torch.testing.assert_close(norm, torch.ones_like(norm), rtol=0, atol=1e-14)


def test_lookups_share_no_memory_with_the_library(library: GaitLibrary) -> None:
    phase, speed = torch.zeros(1, 1), torch.zeros(1, 1)
    before = library.lookup(phase, speed).body_position.clone()
    library.lookup(phase, speed).body_position.add_(1.0)
    library.initial_state(phase, speed)[0].add_(1.0)
    torch.testing.assert_close(library.lookup(phase, speed).body_position, before)


@pytest.mark.parametrize("phase", [0.25, torch.tensor(0.25), torch.zeros(5), np.zeros((5, 1))])
def test_phase_of_wrong_shape_is_refused(library: GaitLibrary, phase: Any) -> None:
    with pytest.raises(ShapeError, match=r"phase must be a tensor of shape \(..., 1\)"):
        library.lookup(phase, torch.ones(5, 1))


# ------------------------------------------------------------ the library as a module


def _reference_bits(library: GaitLibrary) -> list[Tensor]:
    phase, speed = _random(20)
    reference = library.lookup(phase, speed)
    return [*(getattr(reference, name) for name in NAMES), *library.initial_state(phase, speed)]


def test_all_tables_move_to_another_device(small: GaitLibrary) -> None:
    """Checked on the meta device, which refuses tensors of other devices."""
    moved = copy.deepcopy(small).to("meta")
    phase, speed = (torch.zeros(3, 1, device="meta") for _ in range(2))
    reference = moved.lookup(phase, speed)
    tensors = [*(getattr(reference, name) for name in NAMES), *moved.initial_state(phase, speed)]
    assert {tensor.device.type for tensor in [*tensors, moved.stride(speed)]} == {"meta"}
    assert {buffer.device.type for buffer in small.buffers()} == {"cpu"}


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_look_up_the_same_bits(library: GaitLibrary, copied: Any) -> None:
    twin = copied(library)
    assert twin is not library
    for found, expected in zip(_reference_bits(twin), _reference_bits(library), strict=True):
        assert torch.equal(found, expected)


def test_state_dict_excludes_the_tables(library: GaitLibrary) -> None:
    assert not library.state_dict()
    assert not list(library.parameters())
    assert sum(buffer.nbytes for buffer in library.buffers()) < 6e6
