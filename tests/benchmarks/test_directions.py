"""Benchmarks of walks in all directions run, and count what happens."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError
from aslip.transforms.rotation import vertical_quaternion
from aslip.walking import Substeps
from benchmarks.directions import command_changes, figure_of_eight, stops, tracking
from tests.helpers import limp
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("library") / "gaits.npz"
    symmetric_library().save(file)
    return str(file)


def _written(out: Path, name: str) -> dict:
    assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert (out / f"{name}.md").read_text().startswith("|")
    return json.loads((out / f"{name}.json").read_text())


def test_errors_are_mapped_over_the_region(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracking, "_SETTLE", 0.15)
    monkeypatch.setattr(tracking, "_WALK", 0.15)
    config = tracking.Config(library=library, commands=6, out=tmp_path)
    (row,) = tracking.main(config, limp())
    assert row["falls"] == 0
    numbers = _written(tmp_path, "tracking")
    command, twist = np.array(numbers["command"]), np.array(numbers["twist"][0])
    assert command.shape == twist.shape == (6, 3)
    assert np.ptp(command, axis=0).min() > 0.1
    assert row["speed"]["mean"] == pytest.approx(
        np.linalg.norm((twist - command)[:, :2], axis=1).mean(), abs=1e-9
    )
    with pytest.raises(ConfigurationError, match="commands must be 1 or more"):
        tracking.Config(commands=0)


def test_a_fall_counts_once_for_the_change_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots fall at chosen steps; commands tell which change is in force."""
    commands = np.arange(12.0).reshape(4, 1, 3).repeat(2, axis=1)
    hold = np.array([[2, 3], [4, 2], [3, 3], [2, 2]])
    falls = {1: [0], 2: [0], 4: [0], 5: [1], 8: [1], 10: [1]}
    seen = []

    def step(policy: object, env: Mock, td: TensorDict) -> TensorDict:
        del policy, env
        seen.append(td["command"][:, 0].tolist())
        fell = torch.tensor([[robot in falls.get(len(seen) - 1, [])] for robot in range(2)])
        return td.clone().update({"next": TensorDict(terminated=fell, batch_size=2)})

    start = TensorDict(command=torch.zeros(2, 3), batch_size=2)
    monkeypatch.setattr(command_changes, "reset_walks", lambda *_: start.clone())
    monkeypatch.setattr(command_changes, "take_step", step)
    monkeypatch.setattr(command_changes, "next_start", lambda td: td.exclude("next"))
    env = Mock(num_envs=2, reset=lambda td: td.exclude("_reset"))
    found = command_changes.walk_changes(Mock(), env, commands, hold)
    # robot 0 falls before the first change and twice after it, robot 1 after the second and third
    # and, uncounted, after its last command
    assert found == [(0, 0), (1, 1), (2, 1)]
    first, second = zip(*seen, strict=True)
    assert first == (0, 0, 3, 3, 3, 3, 6, 6, 6, 9, 9)
    assert second == (0, 0, 0, 3, 3, 6, 6, 6, 9, 9, 9)


def test_falls_are_reported_with_the_commands_around_them(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a policy robots fall about once a second, start again, and fall again."""
    monkeypatch.setattr(command_changes, "_HOLD", (0.6, 1.2))
    config = command_changes.Config(library=library, changes=6, robots=3, out=tmp_path)
    (row,) = command_changes.main(config, limp())
    assert row["changes"] == 6
    assert 3 <= len(row["falls"]) <= 6
    assert row["rate"] == pytest.approx(1e4 * len(row["falls"]) / 6)
    for old, new in row["falls"]:
        assert old != new
    _written(tmp_path, "command_changes")
    with pytest.raises(ConfigurationError, match="robots must be from 1"):
        command_changes.Config(changes=2, robots=3)


def test_places_in_the_world_are_those_of_the_frame_along_the_path() -> None:
    """The frame has a heading of 2 rad; the pelvis is 0.5 m ahead of it and 0.2 m to its left."""
    turned = vertical_quaternion(torch.tensor([[0.3]]))
    odometry = TensorDict(
        origin=torch.tensor([[3.0, -1.0, 0.0]]),
        pelvis_position=torch.tensor([[0.5, 0.2, 0.9]]),
        pelvis_orientation=turned,
        batch_size=1,
    )
    td = TensorDict(heading=torch.tensor([[2.0]]), odometry=odometry, batch_size=1)
    ahead, left = np.array([np.cos(2.0), np.sin(2.0)]), np.array([-np.sin(2.0), np.cos(2.0)])
    place = np.array([3.0, -1.0]) + 0.5 * ahead + 0.2 * left
    np.testing.assert_allclose(figure_of_eight.world_pose(td, "odometry"), [*place, 2.3], atol=1e-6)


def test_a_path_is_walked_over_the_estimate(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Mock()
    monkeypatch.setattr(figure_of_eight, "make_film", film)
    video = tmp_path / "eight.mp4"
    config = figure_of_eight.Config(
        library=library, speed=0.5, duration=0.45, out=tmp_path, video=video
    )
    (row,) = figure_of_eight.main(config, limp())
    # every other one of 15 policy steps
    assert len(film.call_args.args[1]) == 8
    assert row["time"] == pytest.approx(0.45)
    assert not row["fell"]
    assert 0 < row["estimate"] <= row["estimate_most"] < 0.3
    # within half a second the estimate does not drift far
    assert row["truth"] == pytest.approx(row["estimate"], abs=0.1)
    _written(tmp_path, "figure_of_eight")


def test_a_film_that_fails_leaves_the_measurement(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        figure_of_eight, "make_film", Mock(side_effect=ConfigurationError("no OpenGL"))
    )
    config = figure_of_eight.Config(
        library=library, duration=0.06, out=tmp_path, video=Path("eight.mp4")
    )
    with pytest.raises(ConfigurationError, match="no OpenGL"):
        figure_of_eight.main(config, limp())
    _written(tmp_path, "figure_of_eight")
    with pytest.raises(ConfigurationError, match=r"must end in \.mp4, got 'eight\.gif'"):
        figure_of_eight.Config(video=Path("eight.gif"))


def test_stops_standing_and_starts_are_measured(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Feet at rest stay planted; a robot without a policy falls later."""
    standing_library().save(tmp_path / "gaits.npz")
    for name, time in (("_WALK", 0.03), ("_REST", 0.6), ("_GO_ON", 1.5)):
        monkeypatch.setattr(stops, name, time)
    config = stops.Config(
        library=str(tmp_path / "gaits.npz"), speeds=(0.0,), walks=1, duration=0.5, out=tmp_path
    )
    (row,) = stops.main(config, limp())
    assert sum(row["falls"].values()) == 1
    assert row["falls"]["walk"] == row["falls"]["stop"] == 0
    numbers = _written(tmp_path, "stops")["rows"][0]
    (walk,) = numbers["walks"]
    assert walk["command"] == [0.0, 0.0, 0.0]
    assert walk["fell"] in ("stand", "start")
    with pytest.raises(ConfigurationError, match="standing needs a library with stop and start"):
        stops.main(stops.Config(library=library, out=tmp_path), limp())
    with pytest.raises(ConfigurationError, match="duration must be"):
        stops.Config(duration=0.1)


def test_walks_that_stop_have_sensor_noise_of_their_own(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    standing_library().save(tmp_path / "gaits.npz")
    seeds, whole = [], stops.measure

    def measure(config: stops.Config, *of: Any) -> Any:
        seeds.append(config.seed)
        return whole(config, *of)

    monkeypatch.setattr(stops, "measure", measure)
    for name in ("_WALK", "_REST", "_GO_ON"):
        monkeypatch.setattr(stops, name, 0.06)
    for seed in (0, 0, 1):
        gaits = str(tmp_path / "gaits.npz")
        config = stops.Config(
            library=gaits, speeds=(0.0,), walks=2, duration=0.5, seed=seed, out=tmp_path
        )
        stops.main(config, limp())
    assert seeds[:2] == seeds[2:4]
    assert len({*seeds}) == 4


def test_wishes_to_stand_come_at_all_phases_of_a_stride() -> None:
    library = standing_library()
    command = np.zeros((4, library.command_size))
    stride = library.stride(torch.zeros(1, library.command_size)).item()
    expected = stride * np.arange(4) / 4
    assert stops.delays(library, command) == pytest.approx(expected, rel=1e-6)
    with pytest.raises(ConfigurationError, match="speeds must be finite"):
        stops.Config(speeds=(0.0, math.nan))


def test_a_robot_that_stands_is_measured_after_it_came_to_rest() -> None:
    """It drifts 2 cm and turns 0.1 rad in the last second, and lifts a foot for 0.1 s."""
    ticks = 2000
    time = np.arange(4 * ticks) / ticks
    force = np.full((len(time), 2, 3), 160.0)
    force[1 * ticks + 400 : 1 * ticks + 600, 0] = 0.0
    force[2 * ticks + 100 : 2 * ticks + 300, 1] = 0.0
    along = np.clip(time - 2, 0, 1)[:, None]
    half = 0.05 * along[:, 0]
    orientation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    torque = velocity = np.tile([2.0, *[0.0] * 9], (len(time), 1))
    walk = Substeps(
        along * [0.02, 0.0, 0.5], orientation, np.zeros((len(time), 2, 3)), force, torque,
        velocity, fell=False,
    )  # fmt: skip
    found = stops.quantities(walk, np.zeros(3), np.array([1, 2, 3, 4]) * ticks)
    assert found["fell"] is None
    assert found["planted"] == pytest.approx(0.3)
    assert found["drift"] == pytest.approx(0.02, rel=1e-3)
    assert found["turn"] == pytest.approx(0.1, rel=1e-3)
    assert (found["lifted"], found["power"]) == (1, pytest.approx(4.0))
    short = replace(walk.since(0.0), fell=True, ground_force=force[: 2 * ticks + 5])
    assert stops.quantities(short, np.zeros(3), np.array([1, 2, 3, 4]) * ticks)["fell"] == "stand"
