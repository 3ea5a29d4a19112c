"""Motions of three commands in the moving frame, and the robot that follows them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.ik import Kinematics, leg_torque, pelvis_axes
from aslip.library import GaitLibrary, tabulate
from aslip.library.interpolation import periodic_slopes
from aslip.library.rows import FramedMotion, Rows
from aslip.library.table import ARRAYS
from aslip.robot import SIDES
from aslip.robot.model import load_model
from aslip.rom import Gait, MotionSample, Track
from aslip.rom.arc import Pose, twist_pose

from .bent import Bent

SPEEDS, SIDEWAYS, YAW_RATES = (5, 12), (-0.2, 0.3), (-0.8, 0.0, 1.0)
SAMPLES = 32


@pytest.fixture(scope="module")
def bent(library: GaitLibrary) -> GaitLibrary:
    """Library over forward speed, sideways speed and yaw rate."""
    motions = [Bent(library.gaits[i], y, w) for i in SPEEDS for y in SIDEWAYS for w in YAW_RATES]
    return GaitLibrary.from_motions(motions, samples=SAMPLES)


@pytest.fixture(scope="module")
def turning(library: GaitLibrary) -> Bent:
    """Motion that walks, sidesteps and turns."""
    return Bent(library.gaits[8], -0.25, 0.9)


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    """Legs of Cassie."""
    return Kinematics()


def _rows(kinematics: Kinematics, motion: Bent, phase: np.ndarray) -> Rows:
    return FramedMotion.of(motion, phase).rows(kinematics)


def _path(motion: Bent, phase: np.ndarray) -> Pose:
    return twist_pose(motion.command, phase * motion.stride)


def _in_world(rows: Rows, path: Pose) -> tuple[np.ndarray, np.ndarray]:
    """`qpos` and `qvel` of rows, moved from the moving frame to the world."""
    qpos, qvel = rows["qpos"].copy(), rows["qvel"].copy()
    qpos[:, :3], qvel[:, :3] = path.transform(qpos[:, :3]), path.rotate(qvel[:, :3])
    for row, angle in zip(qpos, path.angle, strict=True):
        turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        mujoco.mju_mulQuat(row[3:7], turn, row[3:7].copy())
    return qpos, qvel


@pytest.mark.parametrize("side", [0, 1])
def test_planted_feet_stay_in_the_world_along_the_path(
    kinematics: Kinematics, turning: Bent, side: int
) -> None:
    """Stance from touchdown to lift-off: position and direction of the toes."""
    lift_off = 0.5 * side
    phase = np.linspace(lift_off + turning.swing + 1e-9, lift_off + 1 - 1e-9, 12)
    rows, path = _rows(kinematics, turning, phase), _path(turning, phase)
    seen = rows["body_position"] + rows["foot_position"][:, side]
    np.testing.assert_allclose(np.ptp(path.transform(seen), axis=0), 0, atol=1e-12)
    toes = rows["foot_heading"][:, side]
    np.testing.assert_allclose(np.ptp(toes + path.angle), 0, atol=1e-12)
    assert np.ptp(toes) > 0.3
    np.testing.assert_allclose(rows["foot_velocity"][:, side], 0, atol=1e-9)


def test_sole_of_the_robot_follows_position_and_toes_of_a_turning_motion(
    kinematics: Kinematics, turning: Bent
) -> None:
    """Forward kinematics of MuJoCo; a planted sole neither moves nor turns about the vertical."""
    phase = np.arange(24) / 24
    rows = _rows(kinematics, turning, phase)
    model = load_model()
    data = mujoco.MjData(model)
    for i, at in enumerate(phase):
        data.qpos, data.qvel = rows["qpos"][i], rows["qvel"][i]
        mujoco.mj_forward(model, data)
        for side, name in enumerate(SIDES):
            site = data.site(f"{name}_foot")
            expected = rows["body_position"][i] + rows["foot_position"][i, side]
            np.testing.assert_allclose(site.xpos, expected, atol=1e-7)
            toes = site.xmat.reshape(3, 3)[:, 0]
            angle = rows["foot_heading"][i, side]
            np.testing.assert_allclose(toes, [np.cos(angle), np.sin(angle), 0], atol=1e-7)
            twist = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site.id, twist, 0)
            expected = rows["foot_velocity"][i, side]
            np.testing.assert_allclose(twist[3:], expected, atol=1e-6)
            if (at - 0.5 * side) % 1 > turning.swing:
                assert abs(twist[2]) < 0.02


def test_velocity_is_the_rate_of_the_configuration(kinematics: Kinematics, turning: Bent) -> None:
    """Central differences in the world, in MuJoCo's convention; loops and pelvis included."""
    step, phase = 1e-5, np.array([0.03, 0.2, 0.31, 0.44, 0.7, 0.95])
    (before, _), (_, qvel), (after, _) = (
        _in_world(_rows(kinematics, turning, at), _path(turning, at))
        for at in (phase - step, phase, phase + step)
    )
    model, found = load_model(), np.empty_like(qvel)
    for i in range(len(phase)):
        mujoco.mj_differentiatePos(model, found[i], 2 * step * turning.stride, before[i], after[i])
    np.testing.assert_allclose(found, qvel, atol=2e-4)
    np.testing.assert_allclose(qvel[:, 5], turning.command[2], atol=1e-12)


def test_mirrored_motions_have_mirrored_legs(kinematics: Kinematics, library: GaitLibrary) -> None:
    """Half a stride later, with sideways speed and yaw rate reversed."""
    phase = np.arange(8) / 8
    one, other = (
        _rows(kinematics, Bent(library.gaits[9], s * 0.2, s * 0.7), phase + shift)
        for s, shift in ((1, 0.0), (-1, 0.5))
    )
    signs = np.array([-1.0, -1, 1, 1, 1])
    for name in ("motor_position", "motor_velocity", "motor_torque"):
        left, right = np.split(one[name], 2, axis=1)
        mirrored = np.concatenate([signs * right, signs * left], axis=1)
        np.testing.assert_allclose(other[name], mirrored, atol=1e-7, err_msg=name)
    for name in ("foot_position", "foot_velocity"):
        mirrored = one[name][:, ::-1] * [1, -1, 1]
        np.testing.assert_allclose(other[name], mirrored, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(other["foot_heading"], -one["foot_heading"][:, ::-1], atol=1e-12)


def test_straight_motion_of_three_commands_has_the_straight_table(library: GaitLibrary) -> None:
    """Bit for bit, with sideways speed and yaw rate 0."""

    class Straight(Bent):
        def sample(self, phase: np.ndarray) -> MotionSample:
            return self.gait.sample(phase)

    gait: Gait = library.gaits[13]
    expected, found = (tabulate([motion], samples=16) for motion in (gait, Straight(gait)))
    assert found.grid == (1, 1, 1)
    for name in ARRAYS:
        array = getattr(found, name)
        np.testing.assert_array_equal(
            array.reshape(getattr(expected, name).shape), getattr(expected, name)
        )


def test_torques_carry_the_ground_forces_of_a_turning_motion(
    kinematics: Kinematics, turning: Bent
) -> None:
    """Power of motors and ground forces balances, relative to the turning pelvis."""
    phase = np.array([0.1, 0.6, 0.9])
    framed = FramedMotion.of(turning, phase)
    rows, rate = framed.rows(kinematics), turning.command[2]
    x, y, _ = np.moveaxis(rows["foot_position"], -1, 0)
    carried = rate * np.stack([-y, x, 0 * x], axis=-1)
    velocity = rows["foot_velocity"] - rows["body_velocity"][:, None] - carried
    by_ground = (framed.sample.ground_force * velocity).sum((1, 2))
    by_motors = (rows["motor_torque"] * rows["motor_velocity"]).sum(1)
    np.testing.assert_allclose(by_motors, -by_ground, atol=1e-9)


# ------------------------------------------------------------------ look-up


def _command(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_legs_are_accelerated_along_the_path_over_ground(
    kinematics: Kinematics, turning: Bent
) -> None:
    """Torques of the moving frame are those of the world, although the frame turns."""
    count = 128
    phase = np.arange(count) / count
    framed = FramedMotion.of(turning, phase)
    plain, moving = framed.rows(kinematics), framed.rows(kinematics, leg_dynamics=True)
    world, qvel = _in_world(plain, _path(turning, phase))
    velocity = pelvis_axes(kinematics, world, qvel)
    acceleration = periodic_slopes(velocity[None])[0] * count / turning.stride
    expected = leg_torque(kinematics, world, velocity, acceleration)
    found = moving["motor_torque"] - plain["motor_torque"]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(found).max() > 20


def test_lookup_over_three_axes_is_continuous_and_clamped(bent: GaitLibrary) -> None:
    """Across cells, at the border and beyond."""
    generator = torch.Generator().manual_seed(0)
    phase = torch.rand(60, 1, generator=generator, dtype=torch.float64)
    command = _command(0.3, -0.5, -1.5) + torch.rand(
        60, 3, generator=generator, dtype=torch.float64
    ) * torch.tensor([1.2, 1.0, 3.0])
    command[:20, 2] = 0.0
    for axis in range(3):
        tiny = 1e-7 * torch.eye(3, dtype=torch.float64)[axis]
        below, above = (bent.lookup(phase, command + s * tiny) for s in (-1, 1))
        for name, value in vars(above).items():
            torch.testing.assert_close(value, getattr(below, name), rtol=0, atol=2e-4)
    inside = torch.maximum(
        torch.minimum(command, _command(1.2, 0.3, 1.0)), _command(0.5, -0.2, -0.8)
    )
    beyond, border = (bent.lookup(phase, c).motor_position for c in (command, inside))
    assert torch.equal(beyond, border)
    strides = bent.stride(command)
    torch.testing.assert_close(strides, bent.stride(inside), rtol=0, atol=0)


def test_initial_state_of_a_turning_command_starts_on_the_path(bent: GaitLibrary) -> None:
    """Pelvis above the origin, along x, with the speeds and the yaw rate of the command."""
    phase, command = torch.rand(9, 1), torch.tensor([0.9, 0.1, 0.6]).expand(9, 3)
    qpos, qvel = bent.initial_state(phase, command)
    assert qpos[:, :2].abs().max() < 0.03
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(9, 4)
    torch.testing.assert_close(qpos[:, 3:7], upright)
    torch.testing.assert_close(
        qvel[:, :2].mean(0), torch.tensor([0.9, 0.1], dtype=torch.float64), rtol=0, atol=0.15
    )
    torch.testing.assert_close(qvel[:, 5], torch.full((9,), 0.6, dtype=torch.float64))


@pytest.mark.parametrize(
    "command", [(0.4, 0.0, 0.0), (1.0, 0.31, 0.0), (1.0, 0.0, -0.9), (1.0, np.nan, 0.0)]
)
def test_commands_outside_the_box_are_named(
    bent: GaitLibrary, command: tuple[float, float, float]
) -> None:
    with pytest.raises(
        SpeedOutOfRangeError,
        match=r"command \(.*forward speed 0\.5 to 1\.2 m/s, sideways speed -0\.2 to 0\.3 m/s, yaw"
        r" rate -0\.8 to 1 rad/s",
    ):
        bent.check_command(command)
    assert bent.check_command((0.5, 0.3, -0.8)) == (0.5, 0.3, -0.8)
    with pytest.raises(ShapeError, match="has 3 numbers"):
        bent.check_command(0.5)


# ------------------------------------------------------------------ refused motions


def test_motion_that_does_not_follow_its_command_is_refused(turning: Bent) -> None:
    """Turning too far, or ending beside the path."""

    class Wrong(Bent):
        def __init__(self, yaw_rate: float, sideways: float) -> None:
            super().__init__(turning.gait, -0.25, 0.9)
            self.command = np.array([self.gait.command[0], -0.25 + sideways, 0.9 + yaw_rate])

        def sample(self, phase: np.ndarray) -> MotionSample:
            return turning.sample(phase)

    with pytest.raises(ConfigurationError, match=r"0\.799 rad; this one turns by 0\.719 rad"):
        tabulate([Wrong(0.1, 0.0)], samples=4)
    with pytest.raises(ConfigurationError, match=r"misses its start by 0\.0\d+ m"):
        tabulate([Wrong(0.0, 0.1)], samples=4)


def test_unreachable_pose_names_its_command(turning: Bent) -> None:
    class Flying(Bent):
        def sample(self, phase: np.ndarray) -> MotionSample:
            sample = super().sample(phase)
            up = np.array([0.0, 0.0, 1.0])
            object.__setattr__(
                sample, "body", Track(sample.body.position + up, sample.body.velocity)
            )
            return sample

    with pytest.raises(ValueError, match=r"command \[ *0\.8 +-0\.25 +0\.9 *\]: pose 0"):
        tabulate([Flying(turning.gait, -0.25, 0.9)], samples=4)
