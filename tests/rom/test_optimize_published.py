"""Gaits agree with those released by the authors of the paper."""

import numpy as np
import pytest

from aslip.rom import Mode, optimize_gait

from .conftest import SPEEDS

# speed [m/s]: stride [s], lowest and highest body [m], sway [m], first and second hump [N],
# largest vertical body speed [m/s], shortest stance leg [m]
PUBLISHED = {
    0.0: (0.8050, 0.8375, 0.9181, 0.0112, 433.0, 429.0, 0.607, 0.8435),
    0.5: (0.8028, 0.8340, 0.9138, 0.0112, 435.0, 432.0, 0.604, 0.8456),
    1.0: (0.7965, 0.8232, 0.9009, 0.0113, 442.0, 441.0, 0.594, 0.8496),
    1.5: (0.7871, 0.8047, 0.8789, 0.0116, 453.0, 454.0, 0.578, 0.8490),
    2.0: (0.7649, 0.8000, 0.8529, 0.0132, 434.0, 437.0, 0.442, 0.8454),
}
# speed [m/s]: lowest force of the standing leg around mid-stance [N]; zero at all other speeds


@pytest.fixture(params=PUBLISHED, ids=str)
def pair(request, gaits):
    """(our gait, published numbers) at one speed."""
    return gaits[SPEEDS.index(request.param)], PUBLISHED[request.param]


def stance_force(gait):
    """Force of the right leg over its stance [N], from touchdown to lift-off."""
    points = len(gait.time) - 1
    return np.roll(gait.leg_force[:-1, 1], points // 4)[: 3 * points // 4]


def test_height_bound_is_active_from_1_6_metres_per_second_only(gaits):
    for gait in gaits:
        active = gait.certificate.margins["body height"] < 1e-4
        assert active == (gait.speed > 1.55), gait.speed


def test_double_stance_shortens_with_speed(gaits):
    """Published: 0.1025 s at rest to 0.0825 s at 2 m/s."""
    double_stance = np.array([gait.double_stance for gait in gaits])
    assert (np.diff(double_stance) < 0.0).all()
    np.testing.assert_allclose(double_stance[[0, -1]], [0.1025, 0.0825], atol=5e-4)


def test_integral_objective_gives_shorter_strides():
    """At rest, the paper's formula misses the published double stance by 8 ms."""
    gait = optimize_gait(0.0, objective="integral")
    assert gait.double_stance == pytest.approx(0.095, abs=1e-3)


def test_gaits_are_the_published_ones(pair):
    """Within 0.5 ms, 0.5 mm (sway 0.3 mm, shortest leg 1 mm), 0.5 % of force and 1 % of speed."""
    gait, (stride, lowest, highest, sway, first, second, speed, shortest) = pair
    assert gait.stride == pytest.approx(stride, abs=5e-4)
    height, force = gait.body.position[:, 2], stance_force(gait)
    np.testing.assert_allclose([height.min(), height.max()], [lowest, highest], atol=5e-4)
    assert np.abs(gait.body.position[:, 1]).max() == pytest.approx(sway, abs=3e-4)
    humps = force[: len(force) // 2].max(), force[len(force) // 2 :].max()
    np.testing.assert_allclose(humps, [first, second], rtol=0.005)
    assert np.abs(gait.body.velocity[:, 2]).max() == pytest.approx(speed, rel=0.01)
    length = np.linalg.norm(gait.body.position - gait.feet.position[:, 1], axis=1)
    assert length[gait.mode != Mode.LEFT].min() == pytest.approx(shortest, abs=1e-3)
