"""Logs of non-default robots and physics are replayed, and forged logs do no harm."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aslip.base.assets import asset_path
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log import Recording, read, replay
from aslip.robot.model import load_model, physics_timesteps
from tests.log.helpers import MakeRecorded, run, with_column


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
    ticks = rows.ticks
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
    assert not replay(replace(log, attachments=files)).equal


# ------------------------------------------------------- other models, forged logs


def test_another_model_is_refused_unless_it_is_given(recording: Recording, tmp_path: Path) -> None:
    """The model attached to a log is named by its hash, and not compiled."""
    xml = asset_path("cassie.xml").read_bytes()
    (tmp_path / "heavy.xml").write_bytes(
        re.sub(rb' mass="([\d.]+)"', lambda old: b' mass="%.4f"' % (1.5 * float(old[1])), xml)
    )
    (tmp_path / "same.xml").write_bytes(xml)
    metadata = {"sha256/model.xml": "0" * 64, "model_digest": "0" * 64}
    other = replace(recording, metadata={**recording.metadata, **metadata})
    with pytest.raises(ConfigurationError, match=r"another model than cassie\.xml; give the MJCF"):
        replay(other)
    assert replay(other, model=tmp_path / "same.xml").equal
    heavy = replay(recording, model=tmp_path / "heavy.xml")
    assert not heavy.equal
    assert heavy.doubts[0].startswith("model_digest is")
    with pytest.raises(FileDamagedError, match=r"compiled from .*gone\.xml"):
        replay(recording, model=tmp_path / "gone.xml")


WRONG_SETTINGS = (
    {"gravity": [0, 0, 9.81]},
    {"robot": "mine"},
    {"timestep": 0.05},
    {"memory": 10**9},
    {"memory": 8.5},
    {"floor_friction": float("inf")},
    {"floor_friction": [1.0]},
)


def test_damaged_settings_of_the_model_are_refused(recording: Recording) -> None:
    settings = json.loads(recording.attachments["model.json"])
    wrong = [json.dumps({**settings, **change}).encode() for change in WRONG_SETTINGS]
    for damage in (*wrong, b"", b"[]", b"{}", b"[" * 100_000):
        files = {**recording.attachments, "model.json": damage}
        with pytest.raises(FileDamagedError, match="model of the log"):
            replay(replace(recording, attachments=files))


@pytest.mark.parametrize("value", [10_000_000, -3, np.nan])
def test_forged_states_do_not_end_the_process(recording: Recording, value: float) -> None:
    """MuJoCo reads the memory of a motor's commands at an index in the state."""
    integration = recording["/state"]["integration"].copy()
    # time, positions, velocities; then per motor a number for users and the index
    integration[:, 1 + 35 + 32 + 1] = value
    assert not replay(with_column(recording, "/state", "integration", integration)).equal


def test_states_of_wrong_size_are_refused(recording: Recording) -> None:
    states = recording["/state"]
    for size in (0, 301, 322):
        integration = np.resize(states["integration"], (len(states), size))
        with pytest.raises(FileDamagedError, match=r"state of the log|remember .* commands"):
            replay(with_column(recording, "/state", "integration", integration))


def test_dynamics_out_of_range_are_refused(recording: Recording) -> None:
    for name in ("payload", "memory"):
        for value in (1e9, np.nan):
            column = np.full(len(recording["/dynamics"]), value)
            with pytest.raises(FileDamagedError, match=f"{name}|commands"):
                replay(with_column(recording, "/dynamics", name, column))


def test_columns_of_text_are_refused(recording: Recording) -> None:
    for topic, name in (("/dynamics", "payload"), ("/step", "motor_target_left_knee")):
        column = np.array(["much"] * len(recording[topic]))
        with pytest.raises(FileDamagedError, match=f"{topic} must have one number"):
            replay(with_column(recording, topic, name, column))
