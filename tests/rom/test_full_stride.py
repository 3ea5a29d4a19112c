"""Laws of optimal gaits in any direction, over the region of commands."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aslip.errors import GaitOptimizationError
from aslip.rom import DIRECTION_MODEL, Mode, mirror, optimize, optimize_gait, optimize_gaits
from aslip.rom.arc import twist_pose
from aslip.rom.collocation import weights
from aslip.rom.program import INTERVALS

from .laws import derivative

POINTS = 2 * INTERVALS
"""Points per contact mode."""
P = DIRECTION_MODEL
"""Model of the gaits."""
COMMANDS = [
    (1.0, 0.0, 0.0),
    (1.0, -0.4, 0.5),
    (0.5, 0.5, 1.0),
    (0.0, 0.0, 0.0),
    (-0.8, 0.3, -1.0),
]
"""Commands straight ahead and in curves, all over the region."""
ARRAYS = ("control", "leg_force", "set_point", "set_point_velocity")


@pytest.fixture(scope="module")
def gaits():
    return dict(zip(COMMANDS, optimize_gaits(COMMANDS, parameters=P), strict=True))


@pytest.fixture(params=COMMANDS, ids=str)
def gait(gaits, request):
    return gaits[request.param]


def state_at(gait, point):
    tracks = gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity
    return np.concatenate([array[point] for array in tracks])


def inputs(gait, first, feet, mode):
    """Inputs (3, 2) at the points of an interval.

    Where modes meet, the gait has the input of the mode that begins. That of the mode that ends
    follows from Simpson's rule for the set-point rates.
    """
    found = gait.control[first : first + 3].copy()
    if (first + 2) % POINTS == 0:
        states = [state_at(gait, first + i) for i in range(3)]
        h = gait.time[first + 2] - gait.time[first]
        rates = [derivative(states[i], found[i], feet, mode, P)[8:] for i in range(2)]
        last = 6 / h * (states[2] - states[0])[8:] - rates[0] - 4 * rates[1]
        found[2] = last - derivative(states[2], np.zeros(2), feet, mode, P)[8:]
    return found


def test_integration_over_the_stride_ends_one_stride_further_along_the_arc(gait):
    """Another integrator and other equations than the certificate's, within 0.1 mm."""
    state = state_at(gait, 0)
    for first in range(0, 4 * POINTS, 2):
        mode, feet = Mode(gait.mode[first]), gait.feet.position[first]
        start, end = gait.time[[first, first + 2]]
        points = np.linspace(0.0, end - start, 3)
        pieces = np.polyfit(points, inputs(gait, first, feet, mode), 2)

        def rate(t, x, start=start, pieces=pieces, feet=feet, mode=mode):
            s = t - start
            return derivative(x, (pieces[0] * s + pieces[1]) * s + pieces[2], feet, mode, P)

        state = solve_ivp(rate, (start, end), state, "RK45", rtol=1e-8, atol=1e-10).y[:, -1]
    forward, sideways, yaw_rate = gait.command
    turned = yaw_rate * gait.stride
    rotation = np.array(
        [[np.cos(turned), -np.sin(turned), 0], [np.sin(turned), np.cos(turned), 0], [0, 0, 1]]
    )
    # the path of constant twist, by Gauss-Legendre quadrature of its velocity
    nodes, weight = np.polynomial.legendre.leggauss(12)
    angle = turned * (nodes + 1) / 2
    velocity = [
        forward * np.cos(angle) - sideways * np.sin(angle),
        forward * np.sin(angle) + sideways * np.cos(angle),
        0 * angle,
    ]
    displacement = gait.stride / 2 * np.array(velocity) @ weight
    np.testing.assert_allclose(
        state[:3], rotation @ gait.body.position[0] + displacement, atol=1e-4
    )
    np.testing.assert_allclose(state[3:6], rotation @ gait.body.velocity[0], atol=1e-3)
    np.testing.assert_allclose(state[6:], state_at(gait, 0)[6:], atol=1e-3)


def mean(gait, values):
    """Mean of (n, k) values over the stride."""
    weight = np.zeros(len(gait.time))
    for k in range(4):
        part = slice(POINTS * k, POINTS * (k + 1) + 1)
        duration = gait.time[part][-1] - gait.time[part][0]
        weight[part] += duration / INTERVALS * weights(INTERVALS)
    return weight @ values / gait.stride


def test_body_moves_at_the_command_in_the_mean(gait):
    frame = twist_pose(gait.command, gait.time).inverse()
    deviation = frame.transform(gait.body.position)
    np.testing.assert_allclose(mean(gait, deviation)[:2], 0.0, atol=1e-9)
    velocity = mean(gait, frame.rotate(gait.body.velocity))
    np.testing.assert_allclose(velocity, [*gait.command[:2], 0.0], atol=1e-6)


def test_standing_leg_carries_at_least_the_bound(gait):
    for mode, leg in ((Mode.LEFT, 0), (Mode.RIGHT, 1)):
        assert gait.leg_force[gait.mode == mode, leg].min() >= 0.15 * P.weight - 1e-6


def test_feet_pass_each_other_at_a_distance(gait):
    sample = gait.sample(np.linspace(0.0, 1.0, 801, endpoint=False))
    distance = across(sample, 0.0)[sample.mode != Mode.DOUBLE].min()
    assert distance >= P.min_foot_distance - 1e-4
    margins = gait.certificate.margins
    closest = min(margins[f"foot distance, {side} swing"] for side in ("left", "right"))
    assert distance - P.min_foot_distance == pytest.approx(closest, abs=1e-4)


def test_footholds_are_as_wide_as_the_approach_of_feet_and_heels_asks_for(gait):
    """The rule of the module's docstring at the four lift-offs and touchdowns."""
    swings = np.array([0.0, gait.single_stance, gait.stride / 2])
    times = np.r_[swings, swings[1] + gait.stride / 2]
    sample = gait.sample(times / gait.stride)
    approach = [gait.step_width - across(sample, behind) for behind in (0.0, P.heel_offset)]
    room = (P.foot_separation - P.min_foot_distance) ** 4 + np.sum(np.power(approach, 4)) / 4
    wanted = P.min_foot_distance + room**0.25
    margin = gait.certificate.margins["foot separation"]
    assert gait.step_width - wanted == pytest.approx(margin, abs=1e-5)


def across(sample, behind):
    """Distance (m,) of the feet, or of points behind them, across the heading."""
    toes = np.stack([np.cos(sample.foot_heading), np.sin(sample.foot_heading)], axis=-1)
    points = sample.feet.position[..., :2] - behind * toes
    left = np.stack([-np.sin(sample.heading.angle), np.cos(sample.heading.angle)], axis=1)
    return np.sum(left * (points[:, 0] - points[:, 1]), axis=1)


def test_feet_stand_still_and_toes_point_along_the_heading_of_mid_stance(gait):
    phase = np.linspace(0.0, 1.0, 2000, endpoint=False)
    sample = gait.sample(np.r_[phase, phase + 1.0])
    for leg, swing in enumerate((Mode.RIGHT, Mode.LEFT)):
        # the stance that ends in the second stride
        (lift_off,) = np.flatnonzero(np.diff(1 * (sample.mode[1000:] == swing)) == 1)[-1:] + 1001
        stance = np.arange(lift_off - np.argmax(sample.mode[:lift_off][::-1] == swing), lift_off)
        np.testing.assert_allclose(sample.feet.velocity[stance, leg], 0.0, atol=1e-9)
        np.testing.assert_allclose(sample.feet.position[stance, leg, 2], 0.0, atol=1e-12)
        assert np.ptp(sample.feet.position[stance, leg], axis=0).max() < 1e-9
        toes = sample.foot_heading[stance, leg]
        middle = sample.heading.angle[stance].mean()
        np.testing.assert_allclose(toes, middle, atol=1e-3)


@pytest.mark.parametrize("command", [c for c in COMMANDS if not any(c[1:])], ids=str)
def test_straight_gaits_are_those_of_half_a_stride(gaits, command):
    """Up to the origin along the path."""
    gait, straight = gaits[command], optimize_gait(command[0], parameters=P)
    assert gait.certificate.cost == pytest.approx(straight.certificate.cost, rel=1e-9)
    assert gait.stride == pytest.approx(straight.stride, abs=1e-7)
    shift = gait.body.position[0, 0] * np.array([1.0, 0.0, 0.0])
    for name in ("body", "feet"):
        position = getattr(gait, name).position - shift
        np.testing.assert_allclose(position, getattr(straight, name).position, atol=1e-5)
    np.testing.assert_allclose(gait.set_point, straight.set_point, atol=1e-5)
    np.testing.assert_allclose(gait.leg_force, straight.leg_force, atol=0.05)


@pytest.mark.parametrize("command", [(1.0, -0.4, 0.5), (-0.8, 0.3, -1.0)], ids=str)
def test_solved_mirror_image_is_the_mirrored_gait(gaits, command):
    gait = gaits[command]
    image, solved = mirror(gait), optimize_gait(gait.command * [1, -1, -1], parameters=P)
    np.testing.assert_array_equal(image.command, solved.command)
    np.testing.assert_array_equal(image.mode, solved.mode)
    np.testing.assert_allclose(image.time, solved.time, atol=1e-8)
    for name in ("body", "feet"):
        for part in ("position", "velocity"):
            found, expected = (getattr(getattr(g, name), part) for g in (image, solved))
            np.testing.assert_allclose(found, expected, atol=1e-6, err_msg=name)
    for name in ARRAYS:
        found, expected = getattr(image, name), getattr(solved, name)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3, err_msg=name)
    assert set(image.certificate.margins) == set(solved.certificate.margins)
    for name, margin in solved.certificate.margins.items():
        assert image.certificate.margins[name] == pytest.approx(margin, rel=1e-4, abs=1e-5), name


def test_gait_does_not_depend_on_the_initial_guess(gaits):
    """From the gait of another command and from a rough guess."""
    command = 0.5, 0.5, 1.0
    alone = optimize_gait(command, parameters=P)
    np.testing.assert_allclose(alone.body.position, gaits[command].body.position, atol=1e-5)
    assert alone.cost == pytest.approx(gaits[command].cost, rel=1e-7)


def test_gait_without_a_certificate_is_refused_with_its_command(gaits, monkeypatch):
    gait = gaits[1.0, -0.4, 0.5]
    failed = dataclasses.replace(gait.certificate, kkt_residual=1.0)
    monkeypatch.setattr(optimize, "certify", lambda *_: failed)
    message = r"at 1 m/s forward, -0\.4 m/s sideways, 0\.5 rad/s is not certified: kkt_residual"
    with pytest.raises(GaitOptimizationError, match=message):
        optimize_gait(gait.command, parameters=P, guess=gait)
