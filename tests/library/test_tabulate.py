"""Tables of motions on a grid of commands, user-defined motions among them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aslip.envs import make_env
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import GaitLibrary, tabulate
from aslip.library.footholds import Footholds
from aslip.library.table import ARRAYS
from aslip.rom import (
    Angle,
    MotionSample,
    Objective,
    PendulumWalk,
    SlipParameters,
    Track,
    optimize_gaits,
)

from .conftest import Shuffle


@pytest.fixture(scope="module")
def shuffles() -> list[Shuffle]:
    """Motions on a grid of 2 forward speeds and 3 sideways speeds."""
    return [Shuffle(x, y) for x in (0.2, 0.6) for y in (-0.1, 0.0, 0.1)]


@pytest.fixture(scope="module")
def grid(shuffles: list[Shuffle]) -> GaitLibrary:
    """Library of the shuffles."""
    return GaitLibrary.from_motions(shuffles, samples=16, torque_jumps=True)


def test_tabulating_new_gaits_gives_the_shipped_table(library: GaitLibrary) -> None:
    """Two gaits are optimised and tabulated again."""
    table = tabulate(optimize_gaits(library.speeds[:2].tolist()), samples=16)
    for name in ARRAYS:
        shipped = getattr(library.table, name)[:2]
        shipped = shipped if name == "strides" else shipped[:, ::8]
        np.testing.assert_allclose(getattr(table, name), shipped, atol=1e-6, err_msg=name)


def test_heavier_model_needs_more_torque() -> None:
    """Parameters and objective of the optimisation reach the library."""
    heavy = SlipParameters(mass=33.3)
    settings: list[tuple[SlipParameters | None, Objective]]
    settings = [(None, "mean"), (heavy, "mean"), (heavy, "integral")]
    gaits = [optimize_gaits((1.0,), parameters=p, objective=objective) for p, objective in settings]
    one, two, three = (tabulate(ones, samples=16) for ones in gaits)
    assert np.abs(two.motor_torque).max() > 1.05 * np.abs(one.motor_torque).max()
    assert three.strides[0] < two.strides[0]
    assert gaits[1][0].parameters == heavy


def test_user_defined_motion_is_tabulated_and_looked_up(
    grid: GaitLibrary, shuffles: list[Shuffle]
) -> None:
    assert grid.table.qpos.shape == (6, 16, 35)
    assert grid.motions == tuple(shuffles)
    phase = torch.arange(16, dtype=torch.float64)[:, None] / 16
    for motion in shuffles:
        sample = motion.sample(phase[:, 0].numpy())
        found = grid.lookup(phase, torch.tensor(motion.command).expand(16, 2))
        np.testing.assert_allclose(found.body_velocity, sample.body.velocity, atol=1e-6)
        left = sample.feet.position[:, 0] - sample.body.position
        np.testing.assert_allclose(found.left_foot_position, left, atol=1e-6)
        assert abs(float(found.body_position[:, :2].mean())) < 0.02


def test_user_defined_motion_guides_a_robot_and_plans_footholds(tmp_path: Path) -> None:
    """The library is saved, loaded and used in the default stack; its footholds are planned."""
    motions = [Shuffle(speed, 0.0) for speed in (0.2, 0.6)]
    for motion in motions:
        motion.command = motion.command[:1]
    library = GaitLibrary.from_motions(motions, samples=32, torque_jumps=True)
    library.save(tmp_path / "own.npz")
    loaded = GaitLibrary.load(tmp_path / "own.npz")
    env = make_env(num_envs=2, library=loaded, num_threads=1, seed=0)
    try:
        walk = env.rollout(3)
    finally:
        env.close()
    at = walk["phase"], walk["command"]
    assert torch.equal(loaded.lookup(*at).motor_torque, library.lookup(*at).motor_torque)
    # the reference is a little ahead of the phase, so only its constants are compared
    apart = walk["reference", "left_foot_position"] - walk["reference", "right_foot_position"]
    torch.testing.assert_close(apart[..., 1], torch.full((2, 3), 0.2), rtol=0, atol=1e-4)
    step = Footholds(loaded).step("left", 0.6)
    np.testing.assert_allclose(step, [0.6 * 0.8 / 2, 0.2], atol=1e-3)


def test_lookup_between_commands_is_multilinear(grid: GaitLibrary) -> None:
    """Exact at the corners, linear along each axis, clamped outside, in any batch."""
    generator = torch.Generator().manual_seed(0)
    x, y, phase = torch.rand(3, 40, 1, generator=generator, dtype=torch.float64)
    command = torch.cat([0.2 + 0.4 * x, -0.1 + 0.2 * y], dim=-1)
    found = grid.lookup(phase, command).motor_position

    def corner(forward: float, row: torch.Tensor) -> torch.Tensor:
        sideways = torch.tensor(grid.table.axes[1].copy())[row]
        at = torch.stack([torch.full_like(sideways, forward), sideways], dim=-1)
        return grid.lookup(phase, at).motor_position

    row = (2 * y[:, 0]).long()
    share = (2 * y[:, 0] - row)[:, None]
    slow, fast = ((1 - share) * corner(v, row) + share * corner(v, row + 1) for v in (0.2, 0.6))
    torch.testing.assert_close(found, ((1 - x) * slow + x * fast).float(), rtol=0, atol=1e-6)
    outside = torch.tensor([[9.0, -9.0]]).expand(40, 2)
    bound = torch.tensor([[0.6, -0.1]], dtype=torch.float64).expand(40, 2)
    assert torch.equal(
        grid.lookup(phase, outside).motor_torque, grid.lookup(phase, bound).motor_torque
    )
    assert grid.stride(command).shape == (40, 1)
    assert torch.equal(grid.lookup(phase[7], command[7]).motor_position, found[7])


def test_library_of_one_motion_clamps_to_its_command() -> None:
    with pytest.warns(UserWarning, match=r"as that of the only motion, \[0.5\]"):
        library = GaitLibrary.from_motions([PendulumWalk(speed=0.5)], samples=16)
    phase = torch.rand(5, 1)
    slow, fast = (library.lookup(phase, torch.full((5, 1), v)) for v in (0.0, 1.0))
    assert torch.equal(slow.motor_position, fast.motor_position)
    assert float(library.stride(torch.zeros(1, 1))) == pytest.approx(0.84)


class Mistaken(PendulumWalk):
    """Walk some of whose entries are wrong."""

    wrong: Callable[[MotionSample], dict[str, Any]]

    def sample(self, phase: np.ndarray) -> MotionSample:
        sample = super().sample(phase)
        return replace(sample, **type(self).wrong(sample))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda s: {"body": Track(s.body.position, 0 * s.body.velocity)},
            r"2 of 2 motions: body.velocity is not the rate of the position or angle, at command"
            r" \[0.3\] by 0.1[0-9] of 0.1",
        ),
        # rates by phase instead of time
        (lambda s: {"feet": Track(s.feet.position, 0.84 * s.feet.velocity)}, "feet.velocity is"),
        (lambda s: {"heading": Angle(s.heading.angle, s.heading.rate + 0.1)}, "heading.rate is"),
        (lambda s: {"ground_force": 0 * s.ground_force}, "carry the robot's 327 N, at .* but 0 N"),
        (lambda s: {"ground_force": s.ground_force[:, ::-1]}, "feet move while they carry load"),
        (
            lambda s: {"ground_force": s.ground_force * [-1, -1, 1]},
            r"mass x \(acceleration \+ gravity\), at command \[0.3\] by 2 of 0.97 m/s²",
        ),
    ],
)
def test_wrong_motions_are_named(
    wrong: Callable[[MotionSample], dict[str, Any]], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Mistaken, "wrong", staticmethod(wrong), raising=False)
    with pytest.warns(UserWarning, match=message) as warned:
        GaitLibrary.from_motions([Mistaken(speed=0.3), Mistaken(speed=0.5)], samples=4)
    assert len(warned) == 1
    assert warned[0].filename == __file__


@pytest.mark.parametrize(
    "commands",
    [
        [],
        [[1.0], [0.5]],
        [[0.5], [0.5]],
        [[0.5], [0.5, 0.0]],
        [[0.2, 0.0], [0.2, 0.1], [0.6, 0.0]],
    ],
)
def test_commands_must_form_a_grid(commands: Sequence[Sequence[float]]) -> None:
    motions = [Shuffle(0.5, 0.0) for _ in commands]
    for motion, command in zip(motions, commands, strict=True):
        motion.command = np.array(command)
    with pytest.raises(ConfigurationError, match="ascending and form a grid"):
        tabulate(motions)


def test_turning_motion_is_refused() -> None:
    class Turning(Shuffle):
        def sample(self, phase: np.ndarray) -> MotionSample:
            turned = Angle(0.3 * phase, np.full(len(phase), 0.3 / self.stride))
            return replace(super().sample(phase), heading=turned)

    with pytest.raises(ConfigurationError, match=r"turns by 0\.3 rad a stride"):
        tabulate([Turning(0.5, 0.0)])


# ------------------------------------------------------------------ the table


def test_arrays_are_read_only(small: GaitLibrary) -> None:
    for array in (*small.table.axes, *(getattr(small.table, name) for name in ARRAYS)):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize("axis", [[], [0.5, 0.5], [1.0, 0.5], [0.5, np.nan]])
def test_values_along_an_axis_must_ascend(small: GaitLibrary, axis: list[float]) -> None:
    with pytest.raises(ConfigurationError, match="ascending commands"):
        replace(small.table, axes=(np.array(axis),))


def test_tables_of_wrong_shape_or_with_nan_are_refused(small: GaitLibrary) -> None:
    for name in ARRAYS:
        array = getattr(small.table, name)
        for wrong in (array[..., None], array[:1]):
            with pytest.raises(ShapeError, match="must have shape"):
                replace(small.table, **{name: wrong})
    qpos = small.table.qpos.copy()
    qpos[0, 0, 2] = np.nan
    with pytest.raises(ConfigurationError, match="qpos"):
        replace(small.table, qpos=qpos)


def test_motion_samples_of_wrong_shape_are_refused() -> None:
    sample = Shuffle(0.5, 0.0).sample(np.zeros(3))
    flat = Track(sample.feet.position[:, 0], sample.feet.velocity[:, 0])
    with pytest.raises(ShapeError, match=r"feet\.position of a motion must have shape \(3, 2, 3\)"):
        replace(sample, feet=flat)
    with pytest.raises(ShapeError, match=r"foot_heading .* finite"):
        replace(sample, foot_heading=np.full((3, 2), np.nan))
