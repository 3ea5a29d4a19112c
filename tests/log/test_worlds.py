"""Logs of non-default robots and physics are replayed, and forged logs do no harm."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.files.assets import asset_path
from aslip.log import Recording, check, read, replay
from aslip.robot.model import load_model, physics_timesteps
from aslip.sim import DYNAMICS
from tests.log.helpers import MakeRecorded, run


@pytest.mark.parametrize("backend", ["batch", pytest.param("dm_control", marks=pytest.mark.slow)])
def test_randomised_robots_are_recorded(
    make_recorded: MakeRecorded, tmp_path: Path, backend: str
) -> None:
    """Dynamics differ from episode to episode; a replay may start in the middle."""
    path = tmp_path / "walk.mcap"
    env = make_recorded(path, backend, num_envs=2, robot=1, dynamics=True)
    run(env, 60)
    last = {name: values[1] for name, values in env.base_env.dynamics.items()}
    env.close()
    assert check(path) == []
    log = read(path)
    rows = log["/dynamics"]
    assert {name: rows[name][-1] for name in last} == last
    assert len(set(rows["mass"])) == int(log.end["episodes"]) > 1
    assert replay(log).equal
    assert replay(log).compared >= 2
    assert replay(log, float(log["/state"].time[-3])).equal


def test_changes_of_dynamics_in_an_episode_are_recorded(
    make_recorded: MakeRecorded, tmp_path: Path
) -> None:
    """Also a torque delay that makes states longer, of this or another robot."""
    path = tmp_path / "walk.mcap"
    env = make_recorded(path, num_envs=2, drop=["fall", "low_reward"])
    td, still = env.reset(), torch.zeros(2, 10)
    changes: dict[int, Callable[[], None]] = {
        10: lambda: env.base_env.set_dynamics({"payload": 7.0, "slope": 0.05}, np.array([0])),
        40: lambda: env.base_env.set_dynamics({"torque_delay": 0.006}, np.array([1])),
        50: lambda: env.base_env.set_dynamics({"torque_delay": 0.009}, np.array([0])),
    }
    for step in range(75):
        changes.get(step, lambda: None)()
        td = env.step_mdp(env.step(td.set("action", still)))
    env.close()
    log = read(path)
    rows = log["/dynamics"]
    ticks = np.rint(rows.time / 0.03).astype(int)
    assert rows["payload"][ticks <= 9].tolist() == [0.0] * int((ticks <= 9).sum())
    assert rows["payload"][ticks == 10].tolist() == [7.0]
    assert [rows["memory"][ticks == at][-1] for at in (33, 40, 50)] == [8, 16, 32]
    for start in (0.0, *log["/state"].time[:-1]):
        result = replay(log, float(start))
        assert result.equal, start
    forgotten = replace(log["/dynamics"], columns={**rows.columns, "payload": 0 * rows["payload"]})
    other = replace(log, series={**log.series, "/dynamics": forgotten})
    assert not replay(other).equal


def test_efforts_of_springs_follow_the_dynamics(
    make_recorded: MakeRecorded, tmp_path: Path
) -> None:
    path = tmp_path / "walk.mcap"
    env = make_recorded(path)
    td = env.reset()
    env.base_env.set_dynamics({"spring_stiffness": 2.0, "joint_damping": 0.5})
    env.step(td.set("action", torch.zeros(1, 10)))
    env.close()
    joints, model = read(path)["/joint_states"], load_model()
    shin = model.joint("left_shin")
    expected = (
        2.0 * shin.stiffness[0] * (model.qpos_spring[shin.qposadr[0]] - joints["position"][-1, 10])
        - 0.5 * shin.damping[0] * joints["velocity"][-1, 10]
    )
    np.testing.assert_allclose(joints["effort"][-1, 10], expected, rtol=1e-12)


def test_physics_at_1_khz_is_recorded(make_recorded: MakeRecorded, tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    env = make_recorded(path, timestep=physics_timesteps()[1])
    run(env, 40)
    env.close()
    log = read(path)
    assert json.loads(log.attachments["model.json"])["timestep"] == physics_timesteps()[1]
    assert log.metadata["timestep_s"] == "0.001"
    assert replay(log).equal
    settings = {**json.loads(log.attachments["model.json"]), "timestep": physics_timesteps()[0]}
    files = {**log.attachments, "model.json": json.dumps(settings).encode()}
    assert not replay(replace(log, attachments=files), strict=False).equal


# ------------------------------------------------------------------ forged logs


def _with_file(recording: Recording, name: str, data: bytes) -> Recording:
    return replace(recording, attachments={**recording.attachments, name: data})


def _settings(recording: Recording, **changes: Any) -> Recording:
    settings = {**json.loads(recording.attachments["model.json"]), **changes}
    return _with_file(recording, "model.json", json.dumps(settings).encode())


def test_changed_model_is_reported(recording: Recording) -> None:
    slippery = _settings(recording, floor_friction=0.5)
    with pytest.raises(ConfigurationError, match="compiles differently"):
        replay(slippery)
    assert "compiles differently" in replay(slippery, strict=False).doubts[0]


@pytest.mark.parametrize(
    "settings",
    [
        {"fields": [["jnt_qposadr", [5], 200000000]]},
        {"fields": [["opt.gravity", [2], 9.81]]},
        {"__class__": "int"},
        {"gravity": [0, 0, 9.81]},
        {"timestep": 0.05},
        {"timestep": float("nan")},
        {"timestep": True},
        {"memory": 10**9},
        {"memory": 0},
        {"memory": 8.5},
        {"visual": "yes"},
        {"floor_friction": -1.0},
        {"floor_friction": float("inf")},
        {"floor_friction": float("nan")},
        {"floor_friction": [1.0]},
    ],
)  # fmt: skip
def test_model_with_forged_settings_is_refused(
    recording: Recording, settings: dict[str, Any]
) -> None:
    with pytest.raises(FileDamagedError, match="model of the log"):
        replay(_settings(recording, **settings), strict=False)


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b"{}", b"[" * 100_000])
def test_model_that_does_not_compile_is_reported(recording: Recording, damage: bytes) -> None:
    for name in ("model.json", "model.xml"):
        with pytest.raises(FileDamagedError, match="model of the log"):
            replay(_with_file(recording, name, damage), strict=False)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name="left_knee"', 'name="left_elbow"'),
        ("<worldbody>", '<worldbody><light name="more"/>'),
        ("<worldbody>", '<include file="/etc/hosts"/><worldbody>'),
        ('nsample="', 'nsample="99999'),
        ('nuserdata="', 'nuserdata="-'),
        ("<mujoco", '<mujoco more="1"'),
        ("</worldbody>", ""),
    ],
)
def test_model_with_forged_structure_is_refused(recording: Recording, old: str, new: str) -> None:
    xml = recording.attachments["model.xml"].decode()
    if old not in xml:
        old, new = "<option ", '<option nonsense="1" '
    forged = _with_file(recording, "model.xml", xml.replace(old, new, 1).encode())
    with pytest.raises(FileDamagedError, match="model of the log"):
        replay(forged, strict=False)


def test_model_with_other_numbers_is_simulated(recording: Recording) -> None:
    """The replay uses the MJCF of the log, not the shipped one."""
    xml = asset_path("cassie.xml").read_bytes()
    heavier = re.sub(
        rb' mass="([\d.]+)"', lambda found: b' mass="%.4f"' % (1.5 * float(found[1])), xml
    )
    assert heavier != xml
    result = replay(_with_file(recording, "model.xml", heavier), strict=False)
    assert not result.equal
    assert "compiles differently" in result.doubts[0]


def _with_column(recording: Recording, topic: str, name: str, column: np.ndarray) -> Recording:
    series = recording[topic]
    other = replace(series, columns={**series.columns, name: column})
    return replace(recording, series={**recording.series, topic: other})


@pytest.mark.parametrize("value", [1e9, -1.0, 0.5, np.nan, np.inf])
@pytest.mark.parametrize("place", [1, 2, 68, 69, 70, 100, -1])
def test_forged_states_are_refused_or_simulated_safely(
    recording: Recording, place: int, value: float
) -> None:
    """Among the numbers is the index of the newest command in a motor's memory."""
    integration = recording["/state"]["integration"].copy()
    integration[:, place] = value
    try:
        replay(_with_column(recording, "/state", "integration", integration), strict=False)
    except AslipError as error:
        assert "state of the log" in str(error)


def test_forged_index_of_a_command_is_refused(recording: Recording) -> None:
    """An index outside the memory of commands is refused."""
    integration = recording["/state"]["integration"].copy()
    # time, positions, velocities; then per motor a number for users and the index
    integration[:, 1 + 35 + 32 + 1] = 10_000_000
    with pytest.raises(FileDamagedError, match="outside of a motor's memory"):
        replay(_with_column(recording, "/state", "integration", integration))


@pytest.mark.parametrize("size", [0, 1, 10, 301, 322])
def test_states_of_wrong_size_are_refused(recording: Recording, size: int) -> None:
    integration = np.resize(recording["/state"]["integration"], (len(recording["/state"]), size))
    with pytest.raises(FileDamagedError, match=r"state of the log|remember .* commands"):
        replay(_with_column(recording, "/state", "integration", integration))


@pytest.mark.parametrize("name", [*DYNAMICS, "memory"])
def test_dynamics_out_of_range_are_refused(recording: Recording, name: str) -> None:
    for value in (1e9, -1e9, np.nan, np.inf):
        column = np.full(len(recording["/dynamics"]), value)
        with pytest.raises(FileDamagedError, match=f"{name}|commands"):
            replay(_with_column(recording, "/dynamics", name, column))
    text = np.array(["much"] * len(recording["/dynamics"]))
    with pytest.raises(FileDamagedError, match="/dynamics must have one number"):
        replay(_with_column(recording, "/dynamics", name, text))


def test_non_numeric_targets_are_refused(recording: Recording) -> None:
    column = np.array(["far"] * len(recording["/step"]))
    with pytest.raises(FileDamagedError, match="motor_target_left_knee"):
        replay(_with_column(recording, "/step", "motor_target_left_knee", column))
