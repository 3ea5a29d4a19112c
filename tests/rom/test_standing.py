"""Laws of standing, and of stop and start between stepping in place and standing."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aslip.errors import ConfigurationError
from aslip.rom import Mode, SlipParameters, Standing, optimize_gait, optimize_transitions

from .laws import check_velocities, derivative

P = SlipParameters(min_stance_force=0.15)
NAMES = ("stop", "start")


@pytest.fixture(scope="module")
def gait():
    """Gait in place."""
    return optimize_gait(0.0, parameters=P)


@pytest.fixture(scope="module")
def transitions(gait):
    return dict(zip(NAMES, optimize_transitions(gait), strict=True))


@pytest.fixture(params=NAMES)
def transition(request, transitions):
    return transitions[request.param]


@pytest.fixture(scope="module")
def standing(transitions):
    return Standing.after(transitions["stop"])


def arrays(sample):
    return {
        "body position": sample.body.position,
        "body velocity": sample.body.velocity,
        "foot position": sample.feet.position,
        "foot velocity": sample.feet.velocity,
        "ground force": sample.ground_force,
        "heading": sample.heading.angle,
        "foot heading": sample.foot_heading,
    }


def assert_equal(found, expected, *, force=1e-3):
    for name, array in arrays(expected).items():
        atol = force if name == "ground force" else 1e-6
        np.testing.assert_allclose(arrays(found)[name], array, atol=atol, err_msg=name)


def test_integration_ends_at_the_last_state(transition):
    """Another integrator and other equations than the certificate's, within 0.1 mm."""
    t, body = transition, transition.body
    states = np.hstack([body.position, body.velocity, t.set_point, t.set_point_velocity])
    state = states[0]
    for first in range(0, len(t.time) - 1, 2):
        points = t.time[first : first + 3] - t.time[first]
        pieces = np.polyfit(points, t.control[first : first + 3], 2)

        def rate(s, x, pieces=pieces):
            control = (pieces[0] * s + pieces[1]) * s + pieces[2]
            return derivative(x, control, t.feet, Mode.DOUBLE, P)

        span = 0.0, points[-1]
        state = solve_ivp(rate, span, state, "RK45", rtol=1e-8, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(state[:3], states[-1, :3], atol=1e-4)
    np.testing.assert_allclose(state[3:], states[-1, 3:], atol=1e-3)


@pytest.mark.parametrize("half", [0, 1], ids=["left foot landed", "right foot landed"])
def test_stop_begins_at_a_touchdown_and_start_ends_at_the_next_lift_off(gait, transitions, half):
    """In the gait, after either foot; the foot that lands has no load yet."""
    stop, start = transitions.values()
    if half:
        stop, start = stop.mirrored(), start.mirrored()
    touchdown = np.array([P.single_stance / gait.stride + half / 2 + 1e-12])
    assert_equal(stop.sample(np.zeros(1)), gait.sample(touchdown), force=5e-3)
    # from below, while the foot that leaves is in stance
    assert_equal(start.sample(np.ones(1)), gait.sample(np.array([(half + 1) / 2 - 1e-12])))


def test_rest_in_between_is_static_equilibrium(transitions, standing):
    stop, start = transitions.values()
    rest = standing.sample(np.array([0.3]))
    assert_equal(stop.sample(np.ones(1)), rest)
    assert_equal(start.sample(np.zeros(1)), rest)
    assert not rest.body.velocity.any()
    assert standing.stride == np.inf
    weight = np.array([0.0, 0.0, P.mass * P.gravity])
    np.testing.assert_allclose(rest.ground_force[0].sum(0), weight, atol=1e-6)
    lever = rest.feet.position[0] - rest.body.position[0]
    np.testing.assert_allclose(np.cross(lever, rest.ground_force[0]).sum(0), 0.0, atol=1e-6)
    middle = rest.feet.position[0].mean(0)
    np.testing.assert_allclose(rest.body.position[0, :2], middle[:2], atol=1e-9)


def test_both_feet_stay_planted_and_loaded(transitions):
    phase = np.linspace(0.0, 1.0, 1001)
    for name, light in (("stop", 0), ("start", 1)):
        sample = transitions[name].sample(phase)
        assert not np.ptp(sample.feet.position, axis=0).any()
        assert not sample.feet.velocity.any()
        load = np.linalg.norm(sample.ground_force, axis=2)
        # between two points the force may dip where it touches its bound
        assert load[:, 1 - light].min() > 0.15 * P.weight - 0.5
        # the foot that lands or leaves is free of load at that instant only
        inner = load[40:, light] if name == "stop" else load[:-40, light]
        assert inner.min() > 10.0
        assert (sample.ground_force[..., 2] > -0.5).all()
        friction = np.linalg.norm(sample.ground_force[..., :2], axis=2)
        assert (friction <= 0.2 * sample.ground_force[..., 2] + 0.5).all()


def test_velocity_is_the_derivative_of_the_position(transition):
    check_velocities(transition, atol=1e-4)


def test_mirror_image_exchanges_left_and_right(transition):
    phase = np.linspace(0.0, 1.0, 7)
    one, image = transition.sample(phase), transition.mirrored().sample(phase)
    sign = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(image.body.position, one.body.position * sign, atol=1e-15)
    np.testing.assert_allclose(image.feet.position, one.feet.position[:, ::-1] * sign, atol=1e-15)
    np.testing.assert_allclose(image.ground_force, one.ground_force[:, ::-1] * sign, atol=1e-9)
    margins = transition.certificate.margins, transition.mirrored().certificate.margins
    assert margins[1]["leg force, stop, right leg"] == margins[0]["leg force, stop, left leg"]


def test_gait_that_walks_has_no_stop(gait):
    walking = dataclasses.replace(gait, command=np.array([0.5]))
    with pytest.raises(ConfigurationError, match=r"the gait in place, got that at \[0\.5\]"):
        optimize_transitions(walking)
