"""Gaits over a grid of directions: solved once, mirrored, kept, in a convex region."""

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import (
    ConfigurationError,
    GaitOptimizationError,
    SolverError,
    UnreachablePoseError,
)
from aslip.library import (
    DirectionGrid,
    GaitFolder,
    GaitLibrary,
    convex_gaits,
    directions,
    solve_directions,
)
from aslip.library.directions import Outcome, Point
from aslip.rom import Gait, SlipParameters
from recipes import direction_library

TURNS = DirectionGrid(forward=(0.5, 1.0), sideways=(0.0,), yaw_rates=(0.0, 0.4))
WIDE = DirectionGrid((-0.5, 0.0, 0.5, 1.0), (0.0, 0.2, 0.4), (0.0, 0.5, 1.0))

Built = tuple[GaitFolder, dict[Point, Outcome], list[tuple[int, int, bool]]]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Folder of a build that was stopped after two gaits and went on, its outcomes and progress."""
    store = GaitFolder(tmp_path_factory.mktemp("build") / "solved", SlipParameters(), samples=8)
    seen: list[tuple[int, int, bool]] = []

    def stop(done: int, count: int, stored: bool) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_directions(TURNS, store, workers=1, progress=stop)
    outcomes = solve_directions(TURNS, store, workers=1, progress=lambda *at: seen.append(at))
    return store, outcomes, seen


def _gaits(outcomes: Mapping[Point, Outcome]) -> dict[tuple[float, ...], Gait]:
    gaits = [outcome for outcome in outcomes.values() if isinstance(outcome, Gait)]
    return {tuple(gait.command.tolist()): gait for gait in gaits}


def _guess(outcomes: Mapping[Point, Outcome], gait: Gait) -> Gait | None:
    """Gait from which one of the grid `TURNS` is solved."""
    point = next(p for p in outcomes if outcomes[p] is gait)
    parent = TURNS.parent(point)
    found = outcomes[parent] if parent else None
    return found if isinstance(found, Gait) else None


def test_interrupted_build_resumes_with_the_gaits_in_its_folder(built: Built) -> None:
    store, outcomes, seen = built
    assert seen == [(1, 4, True), (2, 4, True), (3, 4, False), (4, 4, False)]
    assert len(list(store.folder.iterdir())) == 4
    assert len(outcomes) == 6
    for gait in _gaits(outcomes).values():
        assert gait.certificate.ok
        if gait.command[2] >= 0:
            kept = store.read(gait.command, _guess(outcomes, gait))
            assert isinstance(kept, Gait)
            for name, array in gait.to_arrays().items():
                np.testing.assert_array_equal(kept.to_arrays()[name], array)


def test_right_turns_are_mirror_images_of_left_turns(built: Built) -> None:
    gaits, phase = _gaits(built[1]), np.arange(8) / 8
    left, right = gaits[1.0, 0.0, 0.4], gaits[1.0, 0.0, -0.4]
    assert left.stride == right.stride
    one, other = left.sample(phase), right.sample(phase + 0.5)
    np.testing.assert_allclose(other.leg_force, one.leg_force[:, ::-1], rtol=0, atol=1e-9)
    assert np.ptp(one.leg_force - one.leg_force[:, ::-1]) > 1.0


def test_straight_gaits_are_those_of_the_shipped_library(
    built: Built, library: GaitLibrary
) -> None:
    phase = np.arange(16) / 16
    for speed, index in ((0.5, 5), (1.0, 10)):
        found, expected = _gaits(built[1])[speed, 0.0, 0.0], library.gaits[index]
        assert found.stride == pytest.approx(expected.stride, abs=1e-7)
        assert found.step_width == pytest.approx(expected.step_width, abs=1e-7)
        one, other = found.sample(phase), expected.sample(phase)
        np.testing.assert_allclose(
            one.body.position[:, 1:], other.body.position[:, 1:], rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(one.leg_force, other.leg_force, rtol=0, atol=1e-3)


def test_recipe_writes_library_certificates_and_picture(
    built: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    """It goes on in the folder, so that nothing is solved."""
    out = built[0].folder.parent
    config = direction_library.Config(
        out, TURNS.forward, TURNS.sideways, TURNS.yaw_rates, (), 8, SlipParameters(), workers=1
    )
    direction_library.main(config)
    assert "6 gaits, 0 left out" in capsys.readouterr().out
    library = GaitLibrary.load(out / "gaits.npz")
    assert library.check_command((0.7, 0.0, -0.3))
    assert library.table.qpos.dtype == np.float32
    assert (out / "region.png").read_bytes().startswith(b"\x89PNG")
    with (out / "certificates.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert all(float(row["kkt_residual"]) < 1e-8 for row in rows)
    assert all(float(row["integration_error"]) < 1e-4 for row in rows)


def test_damaged_file_is_no_gait(built: Built) -> None:
    store, outcomes, _ = built
    gait = _gaits(outcomes)[1.0, 0.0, 0.4]
    at = gait.command, _guess(outcomes, gait)
    file = store.file(*at)
    whole = file.read_bytes()
    file.write_bytes(whole[:-30])
    assert store.read(*at) is None
    file.write_bytes(whole)
    assert isinstance(store.read(*at), Gait)
    assert store.read(gait.command, None) is None  # of another guess
    guess = at[1]
    assert guess is not None
    solved_later = replace(guess, certificate=replace(guess.certificate, solve_time=99.0))
    assert store.file(gait.command, solved_later) == file
    assert GaitFolder(store.folder, samples=8).read(*at) is None


# ------------------------------------------------------------------ without the solver


def test_failed_guess_is_followed_by_the_rough_one(
    library: GaitLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    guesses: list[Gait | None] = []

    def optimize(command: np.ndarray, *, guess: Gait | None, **_: Any) -> Gait:
        guesses.append(guess)
        if guess is not None or command[0] > 0.7:
            raise GaitOptimizationError("no gait found")
        return library.gaits[5]

    monkeypatch.setattr(directions, "optimize_gait", optimize)
    store = GaitFolder(tmp_path, samples=8)
    outcome = store.solve(np.array([0.5, 0.0, 0.0]), library.gaits[4])
    assert outcome is library.gaits[5]
    assert store.solve(np.array([0.9, 0.0, 0.0]), library.gaits[4]) == "no gait found"
    assert guesses == [library.gaits[4], None] * 2
    assert store.read(np.array([0.9, 0.0, 0.0]), library.gaits[4]) == "no gait found"


@pytest.mark.parametrize("accident", [KeyboardInterrupt, SystemExit, MemoryError, SolverError])
def test_an_accident_is_no_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, accident: type[BaseException]
) -> None:
    raised = [accident, GaitOptimizationError("no solution for the gait")]

    def optimize(*_: Any, **__: Any) -> Gait:
        raise raised.pop(0)

    monkeypatch.setattr(directions, "optimize_gait", optimize)
    store, command = GaitFolder(tmp_path), np.zeros(3)
    with pytest.raises(accident):
        store.solve(command, None)
    assert not [*tmp_path.iterdir()]
    assert store.solve(command, None) == store.read(command, None) == "no solution for the gait"


def test_command_beyond_the_model_is_a_reason(tmp_path: Path) -> None:
    store = GaitFolder(tmp_path)
    command = np.array([0.0, 0.0, 1.6])
    reason = store.solve(command, None)
    assert reason == "yaw rate must be between -1.5 and 1.5 rad/s, got 1.6"
    assert store.read(command, None) == reason


def test_pose_out_of_reach_is_a_reason(
    library: GaitLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise UnreachablePoseError("the left foot misses its target")

    monkeypatch.setattr(directions, "optimize_gait", lambda *_, **__: library.gaits[5])
    monkeypatch.setattr(directions, "tabulate", refuse)
    store = GaitFolder(tmp_path)
    assert store.solve(np.zeros(3), None) == "the left foot misses its target"
    assert store.read(np.zeros(3), None) == "the left foot misses its target"


def test_legs_too_close_to_each_other_are_a_reason(
    library: GaitLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solves: list[Gait | None] = []

    def optimize(command: np.ndarray, *, guess: Gait | None, **_: Any) -> Gait:
        solves.append(guess)
        return library.gaits[5]

    monkeypatch.setattr(directions, "optimize_gait", optimize)
    usual = GaitFolder(tmp_path, samples=8)
    assert usual.solve(np.zeros(3), None) is library.gaits[5]
    strict = GaitFolder(tmp_path, samples=8, least_clearance=0.5)
    assert strict.read(np.zeros(3), library.gaits[4]) is None
    reason = strict.solve(np.zeros(3), library.gaits[4])
    assert isinstance(reason, str)
    assert re.fullmatch("legs come within 1.. mm of each other, at least 500 mm are wanted", reason)
    assert solves == [None, library.gaits[4]]
    assert strict.read(np.zeros(3), library.gaits[4]) == reason


def test_half_of_the_points_and_their_images_are_all_points_parents_first() -> None:
    limits = ((1.0, 1.0, 0.5, 1.2), (1.0, 1.0, -0.5, 1.2))
    grid = DirectionGrid(WIDE.forward, WIDE.sideways, WIDE.yaw_rates, limits)
    half = grid.half
    assert {*half, *map(grid.image, half)} == set(grid.points)
    assert len(half) < 0.6 * len(grid.points) < 0.6 * 4 * 5 * 5
    roots = [point for point in half if grid.parent(point) is None]
    assert [grid.command(root).tolist() for root in roots] == [[0.0, 0.0, 0.0]]
    assert {grid.parent(point) for point in half} <= {*half, None}
    for point in half:
        mirrored = grid.command(point) * [1, -1, -1]
        np.testing.assert_array_equal(grid.command(grid.image(point)), mirrored)


@pytest.mark.parametrize("hole", [(1.0, 0.0, 0.0), (1.0, 0.4, 1.0), (0.5, 0.2, -0.5)])
def test_region_around_a_missing_gait_is_cut_convex_and_symmetric(
    library: GaitLibrary, hole: tuple[float, float, float]
) -> None:
    """Gaits missing at one command and its mirror image; a stand-in elsewhere."""
    outcomes: dict[Point, Outcome] = dict.fromkeys(WIDE.points, library.gaits[0])
    for point in WIDE.points:
        command = WIDE.command(point)
        if np.allclose(command, hole) or np.allclose(command * [1, -1, -1], hole):
            outcomes[point] = "no gait"
    gaits, left_out = convex_gaits(WIDE, outcomes)
    assert len(gaits) + len(left_out) == len(outcomes)
    assert set(left_out.values()) <= {"no gait", "solved, but outside the convex region"}
    assert {WIDE.image(point) for point in left_out} == set(left_out)
    commands = np.array([WIDE.command(point) for point in WIDE.points])
    kept = np.array([point not in left_out for point in WIDE.points])
    assert not directions.inside_hull(commands, kept).any()
    assert kept.sum() >= 0.5 * len(kept)


def test_straight_gaits_are_cut_at_a_missing_one(library: GaitLibrary) -> None:
    """A grid along one axis has a region, too."""
    grid = DirectionGrid((0.0, 0.5, 1.0, 1.5), (0.0,), (0.0,))
    outcomes: dict[Point, Outcome] = dict.fromkeys(grid.points, library.gaits[0])
    outcomes[3, 0, 0] = "no gait"
    assert set(convex_gaits(grid, outcomes)[1]) == {(3, 0, 0)}
    outcomes[2, 0, 0] = "no gait"
    outcomes[3, 0, 0] = library.gaits[0]
    gaits, left_out = convex_gaits(grid, outcomes)
    assert len(gaits) == 2
    assert left_out[3, 0, 0] == "solved, but outside the convex region"


def test_a_grid_without_gaits_is_an_error_with_the_first_reason() -> None:
    limited = DirectionGrid((0.5, 1.0), (0.0,), (0.0,), ((1.0, 0.0, 0.0, 0.2),))
    with pytest.raises(ConfigurationError, match="no command of the grid is within the limits"):
        convex_gaits(limited, {})
    with pytest.raises(ConfigurationError, match=r"any of the 6 commands; at .*: no gait found"):
        convex_gaits(TURNS, dict.fromkeys(TURNS.points, "no gait found"))
