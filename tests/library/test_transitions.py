"""Stop, standing and start in a library: poses, joints, files."""

import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from aslip.errors import ConfigurationError, FileDamagedError, ShapeError
from aslip.ik import Kinematics, static_torque
from aslip.library import GaitLibrary, TransitionTable, WalkMode
from aslip.library.transitions import TRANSITION_ARRAYS
from aslip.robot import CASSIE, SIDES, STANDARD_GRAVITY
from aslip.robot.model import load_model
from aslip.rom import SlipParameters

HALVES = pytest.mark.parametrize("half", [0.0, 0.5], ids=["left landed", "right landed"])
PLACES = ("body_position", *(f"{side}_foot_position" for side in SIDES))
VELOCITIES = ("body_velocity", *(f"{side}_foot_velocity" for side in SIDES))


def _at(*phases: float) -> Tensor:
    return torch.tensor(phases, dtype=torch.float64)[:, None]


def _modes(mode: int, count: int = 1) -> Tensor:
    return torch.full((count, 1), mode)


def test_poses_place_pelvis_and_soles_as_the_model_does(table: TransitionTable) -> None:
    """At every sample of both transitions, after either foot, with the pelvis as the origin."""
    qpos, kinematics = table.qpos.reshape(-1, table.qpos.shape[-1]), Kinematics()
    np.testing.assert_allclose(qpos[:, :3], table.body_position.reshape(-1, 3), atol=1e-12)
    configuration = kinematics.at_origin(kinematics.to_pinocchio(qpos))
    feet = kinematics.legs(configuration).position
    np.testing.assert_allclose(feet, table.foot_position.reshape(-1, 2, 3), atol=1e-9)
    assert not table.foot_velocity.any()


@HALVES
@pytest.mark.parametrize(
    ("mode", "landing", "atol"), [(WalkMode.STOP, True, 0.03), (WalkMode.START, False, 1e-3)]
)
def test_transitions_join_the_gait_in_place(
    walking: GaitLibrary, table: TransitionTable, mode: int, landing: bool, atol: float, half: float
) -> None:
    """To the precision of 32 samples of a stride, in which a foot that lands moves a little."""
    phase = _at(half + (table.touchdown if landing else 0.5 - 1e-9))
    gait = walking.lookup(phase, torch.zeros(1, 3, dtype=torch.float64))
    found = walking.transition(phase, _modes(mode))
    for name in PLACES:
        torch.testing.assert_close(getattr(found, name), getattr(gait, name), rtol=0, atol=2e-4)
    for name in VELOCITIES:
        torch.testing.assert_close(getattr(found, name), getattr(gait, name), rtol=0, atol=atol)
    for name in ("motor_position", "left_foot_heading", "right_foot_heading"):
        torch.testing.assert_close(getattr(found, name), getattr(gait, name), rtol=0, atol=2e-3)


@HALVES
def test_stop_and_start_meet_in_standing(
    walking: GaitLibrary, table: TransitionTable, half: float
) -> None:
    """At rest, alike after either foot."""
    phase = _at(half + table.standing)
    stop, standing, start = (walking.transition(phase, _modes(mode)) for mode in (1, 2, 3))
    other = walking.transition(_at(0.5 - half + table.standing), _modes(WalkMode.STAND))
    for name, value in vars(standing).items():
        atol = 2e-3 if name == "motor_torque" else 1e-6
        for one in (stop, start, other):
            torch.testing.assert_close(getattr(one, name), value, rtol=0, atol=atol)
    assert torch.cat([getattr(standing, name) for name in VELOCITIES]).abs().max() < 1e-6
    assert standing.motor_velocity.abs().max() < 1e-6


def test_lookup_is_smooth_over_stop_standing_and_start(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    """Position and its derivative along the phase, which passes each mode in turn."""
    for mode, low, high in (
        (WalkMode.STOP, table.touchdown, table.standing),
        (WalkMode.START, table.standing, 0.5 - 1e-9),
    ):
        count = 4000
        phase = torch.linspace(low, high, count, dtype=torch.float64)[:, None]
        found = walking.transition(phase, _modes(mode, count))
        seconds = table.durations[0 if mode == WalkMode.STOP else 1] / (count - 1)
        for name, rate in (("motor_position", 3.0), ("body_position", 1.0)):
            steps = getattr(found, name).double().diff(dim=0) / seconds
            assert steps.abs().max() < rate
            assert steps.diff(dim=0).abs().max() < 0.02, name
        slope = found.body_position.double().diff(dim=0) / seconds
        torch.testing.assert_close(slope, found.body_velocity[1:].double(), rtol=0, atol=0.015)


def test_torques_of_standing_balance_vertical_forces(table: TransitionTable) -> None:
    """The model's legs would push the feet apart, which soft contacts give way to."""
    kinematics, qpos = Kinematics(), table.qpos[0, 0, -1:]
    # the model's weight, on which leg forces and with them the height of standing depend
    half = np.array([0.0, 0.0, SlipParameters().mass * STANDARD_GRAVITY / 2])
    upright = static_torque(kinematics, qpos, np.tile(half, (1, 2, 1)))
    np.testing.assert_allclose(table.motor_torque[0, 0, -1], upright[0], atol=0.05)


def test_feet_of_a_standing_robot_do_not_creep() -> None:
    """On torques of the model's forces they would move apart by 3 cm in 2 s."""
    table = GaitLibrary.load("directions").transitions
    assert table is not None
    model, at = load_model(visual=False), CASSIE.indices
    data = mujoco.MjData(model)
    begin = data.qpos[:] = table.qpos[0, 0, -1]
    target = table.motor_position[0, 0, -1] + table.motor_torque[0, 0, -1] / CASSIE.stiffness
    turn, feet = np.zeros(3), [data.site(f"{side}_foot").xpos for side in SIDES]
    mujoco.mj_forward(model, data)
    before = feet[0] - feet[1]
    for _ in range(4000):
        qpos, qvel = data.qpos, data.qvel
        # a hand keeps the pelvis from falling over, but not from sinking
        mujoco.mju_subQuat(turn, begin[3:7], qpos[3:7])
        hold = data.xfrc_applied[at.pelvis_body]
        hold[:2] = 3000 * (begin[:2] - qpos[:2]) - 300 * qvel[:2]
        hold[3:] = 1000 * turn - 60 * qvel[3:6]
        torque = CASSIE.stiffness * (target - qpos[at.motor_qpos])
        data.ctrl[:] = (torque - CASSIE.damping * qvel[at.motor_qvel]) / CASSIE.gear
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(feet[0] - feet[1], before, atol=2e-3)
    np.testing.assert_allclose(data.sensordata[at.ground_force][:, 1], 0, atol=1.0)


def test_mode_chooses_between_gait_and_transition(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    phase, mode = _at(0.1, 0.4, 0.9, 0.46), torch.tensor([[0], [1], [2], [3]])
    command = torch.tensor([0.3, 0.0, 0.2], dtype=torch.float64).expand(4, 3)
    found = walking.lookup(phase, command, mode)
    walk, other = walking.lookup(phase, command), walking.transition(phase, mode)
    for name, value in vars(found).items():
        assert torch.equal(value[0], getattr(walk, name)[0])
        assert torch.equal(value[1:], getattr(other, name)[1:])
    qpos, qvel = walking.initial_state(phase, command, mode)
    np.testing.assert_allclose(qpos[2], table.qpos[0, 1, -1], atol=1e-12)
    assert qvel[2].abs().max() < 1e-9
    torch.testing.assert_close(qpos[0], walking.initial_state(phase, command)[0][0])


def test_transition_holds_its_end_samples_beyond_its_ends(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    phase = _at(0.0, table.touchdown, 0.49, table.standing)
    found = walking.transition(phase, _modes(WalkMode.STOP, 4)).motor_position
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[2], found[3])


def test_file_keeps_transitions_and_small_libraries_have_none(
    walking: GaitLibrary, table: TransitionTable, small: GaitLibrary, tmp_path: Path
) -> None:
    path = tmp_path / "gaits.npz"
    walking.save(path)
    again = GaitLibrary.load(path).transitions
    assert again is not None
    assert again.touchdown == table.touchdown
    for name in ("durations", *TRANSITION_ARRAYS):
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))
    small.save(path)
    assert GaitLibrary.load(path).transitions is None
    assert small.transitions is None


def test_library_without_transitions_cannot_stand(small: GaitLibrary) -> None:
    with pytest.raises(ConfigurationError, match="this library has no stop and start"):
        small.lookup(torch.zeros(1, 1), torch.ones(1, 1), _modes(WalkMode.STAND))


def test_copies_and_other_devices_have_transitions(walking: GaitLibrary) -> None:
    twin = copy.deepcopy(walking)
    phase, mode = _at(0.4), _modes(WalkMode.STOP)
    expected = walking.transition(phase, mode).motor_position
    assert torch.equal(twin.transition(phase, mode).motor_position, expected)
    moved = twin.to("meta").transition(phase.to("meta"), mode.to("meta"))
    assert moved.motor_position.device.type == "meta"


def test_transitions_of_another_gait_are_refused(
    walking: GaitLibrary, table: TransitionTable
) -> None:
    shifted = replace(table, body_position=table.body_position + 0.01)
    with pytest.raises(ConfigurationError, match=r"join the gait .* a gap of 17\.3 mm"):
        GaitLibrary(None, walking.table, transitions=shifted)
    # after the right touchdown alone
    after_right = table.foot_position.copy()
    after_right[:, 1] += 0.01
    with pytest.raises(ConfigurationError, match=r"join the gait .* a gap of "):
        GaitLibrary(None, walking.table, transitions=replace(table, foot_position=after_right))
    # between a stop and the start after it
    shifted = table.body_position.copy()
    shifted[1, :, 0] += 0.01
    with pytest.raises(ConfigurationError, match=r"begin where a stop ends, got a gap of 17\.3 mm"):
        GaitLibrary(None, walking.table, transitions=replace(table, body_position=shifted))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"touchdown": 0.6}, ConfigurationError, "phase between 0 and 0.5, got 0.6"),
        ({"durations": np.array([0.4, 0.0])}, ConfigurationError, "positive durations"),
        ({"qvel": np.zeros((2, 2, 3))}, ShapeError, r"qvel of transitions must have shape"),
        ({"qvel": np.full((2, 2, 24, 32), np.nan)}, ConfigurationError, "non-finite"),
    ],
)
def test_damaged_tables_are_refused(
    table: TransitionTable,
    change: dict[str, float | np.ndarray],
    error: type[Exception],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        replace(table, **change)


def test_file_with_half_of_its_transitions_is_damaged(
    walking: GaitLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "gaits.npz"
    monkeypatch.setattr("aslip.library.file.TRANSITION_ARRAYS", TRANSITION_ARRAYS[:4])
    walking.save(path)
    with pytest.raises(FileDamagedError):
        GaitLibrary.load(path)
