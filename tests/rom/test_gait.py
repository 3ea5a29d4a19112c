"""Laws of optimal gaits, at the ends and in the middle of the range of speeds."""

import dataclasses
from operator import attrgetter

import numpy as np
import pytest

from aslip.errors import FileDamagedError, ShapeError
from aslip.rom import Gait, Mode, Track
from aslip.rom.collocation import weights
from aslip.rom.program import INTERVALS

from .conftest import SPEEDS
from .laws import check_velocities, energy_function

THREE_SPEEDS = pytest.mark.parametrize("index", [0, 2, 4], ids=["0", "1", "2"])
QUARTER = 2 * INTERVALS
"""Points per contact mode."""
PATHS = ("body.position", "body.velocity", "feet.position", "feet.velocity")
LEGS = ("leg_force", "set_point", "set_point_velocity")
ARRAYS = ("command", "time", "mode", "control", *PATHS, *LEGS)


def simpson(gait, values, mode):
    """Integral of (n,) values over one of the four modes of the stride."""
    part = slice(QUARTER * mode, QUARTER * (mode + 1) + 1)
    duration = gait.time[part][-1] - gait.time[part][0]
    return duration / INTERVALS * weights(INTERVALS) @ values[part]


@THREE_SPEEDS
def test_stride_is_periodic_with_the_requested_speed(gaits, index):
    g = gaits[index]
    moved = g.body.position[-1] - g.body.position[0]
    np.testing.assert_allclose(moved, [SPEEDS[index] * g.stride, 0.0, 0.0], atol=1e-9)
    for array in (g.body.velocity, g.set_point, g.set_point_velocity):
        np.testing.assert_allclose(array[-1], array[0], atol=1e-8)


@THREE_SPEEDS
def test_second_half_mirrors_the_first(gaits, index):
    g, half = gaits[index], 2 * QUARTER
    step = g.body.position[half:] - g.body.position[: half + 1] * [1.0, -1.0, 1.0]
    np.testing.assert_allclose(step, np.tile([g.step_length, 0.0, 0.0], (half + 1, 1)), atol=1e-9)
    for name in ("leg_force", "set_point", "control"):
        array = getattr(g, name)
        np.testing.assert_allclose(array[half:], array[: half + 1, ::-1], atol=1e-6)


@THREE_SPEEDS
def test_stance_force_has_two_humps(gaits, index):
    """Ground reaction forces of spring-mass walking: up, down and up again."""
    # right stance, from its touchdown at the end of left single stance
    force = np.roll(gaits[index].leg_force[:-1, 1], QUARTER)[: 3 * QUARTER]
    slope = np.sign(np.diff(force))
    assert np.sum((slope[:-1] > 0) & (slope[1:] < 0)) == 2
    middle = force[3 * QUARTER // 2 - QUARTER // 4 : 3 * QUARTER // 2 + QUARTER // 4].min()
    assert middle < 0.15 * force.max()


@THREE_SPEEDS
def test_energy_changes_by_actuator_work_minus_damper_loss(gaits, index):
    g = gaits[index]
    state = np.hstack([g.body.position, g.body.velocity, g.set_point, g.set_point_velocity]).T
    feet = g.feet.position[:, 0].T, g.feet.position[:, 1].T
    for number, mode in enumerate((Mode.RIGHT, Mode.DOUBLE, Mode.LEFT, Mode.DOUBLE)):
        function = energy_function(mode, g.parameters)
        energy, supplied, lost = (v.full().ravel() for v in function(state, g.control.T, *feet))
        change = energy[QUARTER * (number + 1)] - energy[QUARTER * number]
        # 1 mJ of some 400 J: the order of Simpson's rule at 12 ms
        work = simpson(g, supplied - lost, number)
        assert change == pytest.approx(work, abs=1e-3)


@THREE_SPEEDS
def test_bounds_hold_between_the_collocation_points(gaits, index):
    g = gaits[index]
    dense = g.sample(np.linspace(0.0, 1.0, 4001))
    # of 440 N: between two points the force may dip where it touches zero
    assert dense.leg_force.min() > -0.5
    assert dense.body.position[:, 2].min() > g.parameters.min_body_height - 1e-5
    left = np.linalg.norm(dense.body.position - dense.feet.position[:, 0], axis=1)
    assert left[dense.mode != Mode.RIGHT].max() < g.parameters.max_leg_length


@THREE_SPEEDS
def test_feet_are_still_and_on_the_ground_in_stance(gaits, index):
    g = gaits[index]
    for side, swing in enumerate((Mode.RIGHT, Mode.LEFT)):
        stance = g.mode != swing
        np.testing.assert_allclose(g.feet.position[stance, side, 2], 0.0, atol=1e-12)
        np.testing.assert_allclose(g.feet.velocity[stance, side], 0.0, atol=1e-9)


def test_landing_spring_is_slack_at_touchdown(gait):
    touchdown = QUARTER
    length = np.linalg.norm(gait.body.position - gait.feet.position[:, 0], axis=1)[touchdown]
    assert gait.set_point[touchdown, 0] == pytest.approx(length, abs=1e-9)


def test_cost_is_the_integral_of_the_squared_inputs(gait):
    effort = np.sum(gait.control**2, axis=1)
    total = sum(simpson(gait, effort, mode) for mode in range(4))
    assert gait.cost == pytest.approx(total, rel=1e-4)
    assert gait.certificate.cost == pytest.approx(gait.cost / gait.stride, rel=1e-12)


def test_modes_are_right_double_left_double(gait):
    changes = gait.mode[np.r_[True, np.diff(gait.mode) != 0]]
    assert [Mode(m) for m in changes] == [
        Mode.RIGHT,
        Mode.DOUBLE,
        Mode.LEFT,
        Mode.DOUBLE,
        Mode.RIGHT,
    ]


def test_sampling_at_collocation_points_returns_their_values(gait):
    sample = gait.sample(gait.time[:-1] / gait.stride)
    for name in (*PATHS, *LEGS):
        get = attrgetter(name)
        np.testing.assert_allclose(get(sample), get(gait)[:-1], atol=1e-6, err_msg=name)
    np.testing.assert_array_equal(sample.mode, gait.mode[:-1])


def test_sampled_velocities_are_derivatives(gait):
    check_velocities(gait, atol=1e-4)


def test_sample_one_stride_later_is_one_stride_ahead(gait):
    now, later = gait.sample(np.array([0.3])), gait.sample(np.array([1.3]))
    ahead = [[gait.speed * gait.stride, 0.0, 0.0]]
    np.testing.assert_allclose(later.body.position - now.body.position, ahead, atol=1e-12)
    moved = later.feet.position[:, 1] - now.feet.position[:, 1]
    np.testing.assert_allclose(moved, ahead, atol=1e-12)
    np.testing.assert_allclose(later.leg_force, now.leg_force, atol=1e-9)


def test_arrays_survive_a_file_without_pickle(gait, tmp_path):
    np.savez(tmp_path / "gait.npz", **gait.to_arrays())
    with np.load(tmp_path / "gait.npz", allow_pickle=False) as file:
        again = Gait.from_arrays(dict(file))
    for name in ARRAYS:
        np.testing.assert_array_equal(attrgetter(name)(again), attrgetter(name)(gait))
    assert (again.stride, again.cost) == (gait.stride, gait.cost)
    assert (again.certificate, again.parameters) == (gait.certificate, gait.parameters)


def test_arrays_are_read_only_copies(gait):
    for name in ARRAYS:
        with pytest.raises(ValueError, match="read-only"):
            attrgetter(name)(gait)[0] = 1
    arrays = gait.to_arrays()
    arrays["time"][0] = 1.0
    assert gait.time[0] == 0.0


def test_missing_fields_and_unreadable_certificates_are_named(gait):
    arrays = gait.to_arrays()
    with pytest.raises(FileDamagedError, match="unreadable"):
        Gait.from_arrays(arrays | {"certificate": np.array("{")})
    del arrays["control"]
    with pytest.raises(FileDamagedError, match="control"):
        Gait.from_arrays(arrays)


def test_wrong_shape_is_named(gait):
    with pytest.raises(ShapeError, match="control"):
        dataclasses.replace(gait, control=gait.control[:-1])
    with pytest.raises(ShapeError, match=r"feet\.velocity must have shape \(201, 2, 3\)"):
        dataclasses.replace(gait, feet=Track(gait.feet.position, gait.feet.velocity[:, 0]))


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("kkt_residual", 9e-9, 2e-8),
        ("kkt_residual", 0.0, np.nan),
        ("max_defect", 9e-9, 2e-8),
        ("integration_error", 9e-5, 2e-4),
        ("margins", {"body height": -9e-9}, {"body height": -2e-8}),
    ],
)
def test_certificate_fails_beyond_each_tolerance(gait, name, good, bad):
    """One value just within and one beyond each tolerance."""
    assert dataclasses.replace(gait.certificate, **{name: good}).ok
    assert not dataclasses.replace(gait.certificate, **{name: bad}).ok


@THREE_SPEEDS
def test_ground_force_acts_along_the_legs_and_carries_the_weight(gaits, index):
    gait = gaits[index]
    sample = gait.sample(np.arange(4000) / 4000)
    leg = sample.body.position[:, None] - sample.feet.position
    np.testing.assert_allclose(np.cross(sample.ground_force, leg), 0.0, atol=1e-9)
    size = np.linalg.norm(sample.ground_force, axis=-1)
    np.testing.assert_allclose(size, np.abs(sample.leg_force), atol=1e-9)
    carried = sample.ground_force[..., 2].sum(axis=1).mean()
    assert carried == pytest.approx(gait.parameters.weight, rel=0.005)
