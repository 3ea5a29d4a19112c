"""Robots that start at any place and yaw walk as straight as those that start at the origin."""

import math
from typing import cast

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.utils import step_mdp

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.estimation import StateEstimator
from aslip.transforms import ODOMETRY_SIZES, EstimatedState, ReferenceStart, TrueState
from aslip.transforms.heading import in_heading_frame, start_of, true_heading
from aslip.walking import evaluate, record_walks

DEGREES = (0.0, 57.0, -172.0)
ANGLES = torch.deg2rad(torch.tensor(DEGREES, dtype=torch.float64))[:, None]
NUM = len(DEGREES)
SPEED = 0.5
# steps within which robots without `HeadingFrame` fell from 57 degrees on
STEPS = 100


def _about_z(angle: Tensor) -> Rotation:
    """Quaternions of rotations by (n, 1) angles about z."""
    return Rotation.from_rotvec(angle.numpy() * [0.0, 0.0, 1.0])


class TurnedStart(ReferenceStart):
    """Start on the reference, rotated about the world's origin and moved."""

    def __init__(
        self,
        library: aslip.GaitLibrary,
        angle: Tensor = ANGLES,
        place: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        super().__init__(library)
        self._angle, self._place = angle, torch.tensor(place)

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict = super()._reset_env_preprocess(tensordict)
        turn = _about_z(self._angle)
        qpos, qvel = (tensordict["initial", name].clone() for name in ("qpos", "qvel"))
        qpos[:, :3] = torch.from_numpy(turn.apply(qpos[:, :3].numpy()))
        qpos[:, :2] += self._place
        qpos[:, 3:7] = torch.from_numpy(
            (turn * Rotation.from_quat(qpos[:, 3:7].numpy(), scalar_first=True)).as_quat(
                scalar_first=True
            )
        )
        qvel[:, :3] = torch.from_numpy(turn.apply(qvel[:, :3].numpy()))
        tensordict.set(("initial", "qpos"), qpos)
        return tensordict.set(("initial", "qvel"), qvel)


def _start(num: int = NUM, heading: Tensor | None = None) -> TensorDict:
    start = {"command": torch.full((num, 1), SPEED), "phase": torch.zeros(num, 1)}
    if heading is not None:
        start["heading"] = heading
    return TensorDict(start, batch_size=[num])


def _turned(library: aslip.GaitLibrary, **settings: object) -> StackEnv:
    settings = {"num_envs": NUM, "drop": EPISODE_ENDS} | settings
    replace = {"start": TurnedStart(library)} | cast("dict", settings.pop("replace", {}))
    return aslip.make_env(seed=3, num_threads=1, replace=replace, **settings)  # pyright: ignore[reportArgumentType]


# -------------------------------------------------------------------------- walking


def test_robots_that_start_turned_walk_as_straight_as_others(library: aslip.GaitLibrary) -> None:
    env = _turned(library)
    results = evaluate(aslip.load_policy("straight"), env, [SPEED] * NUM, STEPS)
    for degrees, result in zip(DEGREES, results, strict=True):
        assert result.survived, degrees
        assert result.mean_speed == pytest.approx(SPEED, abs=0.08), degrees
        assert result.lateral_drift < 0.1, degrees
        assert result.total / STEPS > 0.9, degrees
        assert result.terms["straight_diff"] > 0.94, degrees
        assert result.terms["foot_orient"] > 0.85, degrees


def test_turned_robots_get_the_same_rewards_and_observations(library: aslip.GaitLibrary) -> None:
    """Differences are rounding errors, in the steps before these grow."""
    env = _turned(library, drop=(*EPISODE_ENDS, "noise"))
    policy, td = aslip.load_policy("straight"), env.reset(_start())
    entries = [("odometry", name) for name in ODOMETRY_SIZES]
    for _ in range(6):
        for entry in entries:
            values = cast("Tensor", td[entry])
            torch.testing.assert_close(values, values[:1].expand_as(values), atol=2e-2, rtol=0)
        td = env.step(policy(td))
        reward = cast("Tensor", td["next", "reward"])
        torch.testing.assert_close(reward, reward[:1].expand_as(reward), atol=3e-3, rtol=0)
        td = step_mdp(td)


def test_rewards_of_the_estimate_are_in_the_heading_frame(library: aslip.GaitLibrary) -> None:
    """Also of robots that start elsewhere."""
    start = TurnedStart(library, place=(5.0, -3.0))
    env = _turned(library, reward_on="estimate", replace={"start": start})
    for result in evaluate(aslip.load_policy("straight"), env, [SPEED] * NUM, 30):
        assert result.terms["foot_orient"] > 0.85
        assert result.terms["straight_diff"] > 0.94
        assert result.lateral_drift < 0.1


def test_metrics_are_along_the_heading(library: aslip.GaitLibrary) -> None:
    env = _turned(library, drop=(*EPISODE_ENDS, "noise"))
    walks = record_walks(aslip.load_policy("straight"), env, np.full((24, NUM), SPEED))
    assert np.abs(walks.pelvis_velocity[10:, :, 0].mean(0) - SPEED).max() < 0.1
    assert np.abs(walks.pelvis_position[..., 1]).max() < 0.1
    assert (walks.foot_position[:, :, 0, 1] > walks.foot_position[:, :, 1, 1]).all()


# --------------------------------------------------------------------- setting the heading


def test_the_heading_is_kept_and_can_be_set(library: aslip.GaitLibrary) -> None:
    env = _turned(library)
    policy = aslip.load_policy("straight")
    td = env.reset(_start())
    torch.testing.assert_close(td["heading"], ANGLES.float(), atol=1e-6, rtol=0)
    assert float(td["heading"][0]) == 0.0
    chosen = ANGLES.float() + 0.3
    td = env.reset(_start(heading=chosen))
    for _ in range(3):
        assert torch.equal(cast("Tensor", td["heading"]), chosen)
        yaw = _yaw(cast("Tensor", td["estimate", "orientation"]))
        torch.testing.assert_close(yaw, torch.full((NUM, 1), -0.3), atol=0.05, rtol=0)
        td = step_mdp(env.step(policy(td)))
    # a caller changes the heading between steps
    td["heading"] = chosen - 0.3
    td = step_mdp(env.step(policy(td)))
    turned = _yaw(cast("Tensor", td["estimate", "orientation"]))
    torch.testing.assert_close(turned, yaw + 0.3, atol=0.1, rtol=0)


def _yaw(quaternion: Tensor) -> Tensor:
    """Yaw (n, 1) of orientations (n, 4)."""
    angles = Rotation.from_quat(quaternion.numpy(), scalar_first=True).as_euler("ZYX")
    return torch.from_numpy(angles[:, :1]).float()


def test_a_partial_reset_takes_the_true_heading(library: aslip.GaitLibrary) -> None:
    env = _turned(library)
    td = env.reset(_start(heading=torch.full((NUM, 1), 0.1)))
    td["_reset"] = torch.tensor([[False], [True], [False]])
    td = env.reset(td)
    expected = torch.full((NUM, 1), 0.1)
    expected[1] = ANGLES.float()[1]
    torch.testing.assert_close(td["heading"], expected, atol=1e-6, rtol=0)


def test_invalid_headings_are_refused(library: aslip.GaitLibrary) -> None:
    env = _turned(library)
    with pytest.raises(ConfigurationError, match="heading must be finite"):
        env.reset(_start(heading=torch.full((NUM, 1), math.nan)))
    with pytest.raises(ShapeError, match="heading must have shape"):
        env.reset(_start(heading=torch.zeros(NUM)))
    packet = np.zeros(42)
    with pytest.raises(ConfigurationError, match="heading must be finite"):
        StateEstimator().start(packet, heading=math.inf)


# ------------------------------------------------------------------------- the frame


def _truth(generator: torch.Generator, num: int = 6) -> dict[str, Tensor]:
    values = {
        name: torch.randn(num, size, generator=generator, dtype=torch.float64)
        for name, size in ODOMETRY_SIZES.items()
    }
    for name, value in values.items():
        if "orientation" in name:
            value = torch.nn.functional.normalize(value, dim=-1)
            values[name] = torch.where(value[:, :1] < 0, -value, value)
    return values | {"slope": torch.zeros(num, 1, dtype=torch.float64)}


def test_with_zero_heading_slope_and_origin_odometry_is_the_truth_bit_for_bit() -> None:
    truth = {name: value.float() for name, value in _truth(torch.Generator()).items()}
    zero = torch.zeros(6, 1)
    entries = in_heading_frame(truth, zero, zero.expand(6, 3))
    for name in ODOMETRY_SIZES:
        assert torch.equal(entries[name], truth[name]), name


def test_odometry_does_not_depend_on_the_pose_of_the_world_frame() -> None:
    truth = _truth(torch.Generator().manual_seed(1))
    headings, places = torch.linspace(-3, 3, 6, dtype=torch.float64)[:, None], torch.randn(6, 3)
    places[:, 2] = 0
    turns = _about_z(headings)
    moved = dict(truth)
    for name in ODOMETRY_SIZES:
        value = truth[name].numpy()
        if "orientation" in name:
            turned = turns * Rotation.from_quat(value, scalar_first=True)
            moved[name] = torch.from_numpy(turned.as_quat(canonical=True, scalar_first=True))
        else:
            moved[name] = torch.from_numpy(turns.apply(value))
            if "position" in name:
                moved[name] = moved[name] + places.double()
    entries = in_heading_frame(moved, headings, places.double())
    for name in ODOMETRY_SIZES:
        torch.testing.assert_close(entries[name], truth[name], atol=1e-7, rtol=0)


# --------------------------------------------------------------------------- slopes

SLOPE = 0.1


@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_on_a_slope_truth_and_odometry_are_in_one_frame(
    library: aslip.GaitLibrary, degrees: float
) -> None:
    """The estimator agrees with a perfect one, and so do the rewards."""
    angle = torch.full((1, 1), math.radians(degrees), dtype=torch.float64)
    env = _turned(
        library,
        num_envs=1,
        drop=(*EPISODE_ENDS, "noise", "fall"),
        replace={"start": TurnedStart(library, angle)},
    )
    env.base_env.set_dynamics({"slope": SLOPE})
    perfect, policy, td = TrueState(), aslip.load_policy("straight"), env.reset(_start(1))
    for step in range(20):
        td = step_mdp(env.step(policy(td)))
        truth = perfect._call(td.clone())
        # the first velocities come from a foot that is assumed to be at rest
        for name, atol in ({"velocity": 0.05, "height": 0.04} if step > 4 else {}).items():
            torch.testing.assert_close(
                td["estimate", name], truth["estimate", name], atol=atol, rtol=0
            )
        torch.testing.assert_close(
            td["estimate", "orientation"], truth["estimate", "orientation"], atol=1e-3, rtol=0
        )
        for side in ("left", "right"):
            name = f"{side}_foot_orientation"
            torch.testing.assert_close(
                td["odometry", name], td["true_odometry", name], atol=2e-3, rtol=0
            )


@pytest.mark.parametrize("ground", [0.0, 0.5])
def test_a_foot_flat_on_a_slope_has_the_slopes_pitch(ground: float) -> None:
    """The frame's z is up against gravity; uphill is along x, downhill along -x."""
    level = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    truth = {
        name: level if size == 4 else torch.zeros(1, 3, dtype=torch.float64)
        for name, size in ODOMETRY_SIZES.items()
    }
    truth["slope"] = torch.full((1, 1), SLOPE, dtype=torch.float64)
    truth["ground_height"] = torch.full((1, 1), ground, dtype=torch.float64)
    truth["pelvis_position"] = torch.tensor([[2.0, 0.0, 0.9 + ground]], dtype=torch.float64)
    truth["pelvis_velocity"] = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    origin = start_of(truth)
    assert torch.allclose(true_heading(truth), torch.zeros(1, 1, dtype=torch.float64))
    seen = in_heading_frame(truth, true_heading(truth), origin)
    pitch = Rotation.from_quat(seen["left_foot_orientation"].numpy(), scalar_first=True)
    np.testing.assert_allclose(pitch.as_euler("ZYX")[0], [0, -SLOPE, 0], atol=1e-12)
    expected = [[math.cos(SLOPE), 0.0, math.sin(SLOPE)]]
    np.testing.assert_allclose(seen["pelvis_velocity"], expected, atol=1e-12)
    # the start is straight above the origin; heights count from the ground there
    np.testing.assert_allclose(
        seen["pelvis_position"], [[0.0, 0.0, 0.9 / math.cos(SLOPE)]], atol=1e-12
    )


# ------------------------------------------------------------------------ symmetry


def test_without_the_heading_frame_the_first_packet_gives_the_heading(
    library: aslip.GaitLibrary,
) -> None:
    terms = ("com_vel", "foot_pos", "straight_diff", "foot_orient")
    env = _turned(library, drop=(*EPISODE_ENDS, "noise", "heading", *terms))
    assert isinstance(env.transforms[env.transform_names.index("estimator")], EstimatedState)
    td = env.reset(_start())
    orientation = cast("Tensor", td["estimate", "orientation"])
    torch.testing.assert_close(orientation, orientation[:1].expand(NUM, 4), atol=1e-5, rtol=0)
