"""Error messages for targets out of reach and malformed targets."""

from __future__ import annotations

import re

import numpy as np
import pytest

from aslip.errors import ShapeError, UnreachablePoseError
from aslip.ik import BodyTarget, solve

SIDEWAYS = 0.12


def _stand(kinematics, left=(0.0, SIDEWAYS, 0.0), **left_options):
    """Solve one pose with a given target of the left foot; the right one is within reach."""
    return solve(
        kinematics,
        BodyTarget(np.array([[0.0, 0.0, 0.85]])),
        BodyTarget(np.array([left]), **left_options),
        BodyTarget(np.array([[0.0, -SIDEWAYS, 0.0]])),
    )


def _about(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    return np.array([[np.cos(angle / 2), *(np.sin(angle / 2) * np.array(axis))]])


def _message(kinematics, **pose) -> str:
    with pytest.raises(UnreachablePoseError) as caught:
        _stand(kinematics, **pose)
    return str(caught.value)


def test_target_too_low_reports_a_stretched_leg(kinematics):
    message = _message(kinematics, left=(0.0, SIDEWAYS, -0.6))
    assert "pose 0: the left foot" in message
    assert "leg fully stretched, left_knee at its limit -0.6458 rad (-37 deg)" in message


def test_target_too_high_reports_a_bent_leg_and_its_limit(kinematics):
    message = _message(kinematics, left=(0.0, SIDEWAYS, 0.5))
    assert "leg fully bent, left_tarsus at its limit 2.9671 rad (170 deg)" in message


def test_missed_distance_grows_with_the_distance_of_the_target(kinematics):
    """Below the hip, lowering the target lengthens the miss by as much."""
    misses = []
    for depth in (0.3, 0.31, 0.6):
        message = _message(kinematics, left=(0.0, SIDEWAYS, -depth))
        found = re.search(r"misses its target by ([\d.]+) m", message)
        assert found
        misses.append(float(found.group(1)))
    np.testing.assert_allclose(np.diff(misses), (0.01, 0.29), atol=2e-3)
    # the miss is the length that the leg lacks: at 0.27 m the foot still reaches its target
    assert misses[0] == pytest.approx(0.03, abs=0.01)
    _stand(kinematics, left=(0.0, SIDEWAYS, -0.27))


@pytest.mark.parametrize(
    ("joint", "pose"),
    [
        ("left_hip_roll at its limit 0.3927 rad (22.5 deg)", {"left": (0.0, 0.6, 0.1)}),
        ("left_hip_yaw at its limit 0.3927", {"orientation": _about((0, 0, 1), 0.5)}),
        ("left_hip_pitch at its limit 1.3963 rad (80 deg)", {"left": (0.6, SIDEWAYS, 0.5)}),
        ("left_foot_crank at its limit -0.5236", {"orientation": _about((0, 1, 0), -1.2)}),
        ("left_foot at its limit -2.4435 rad (-140 deg)", {"orientation": _about((0, 1, 0), 1.0)}),
    ],
)
def test_limiting_joint_is_named(kinematics, joint, pose):
    assert joint in _message(kinematics, **pose)


@pytest.mark.parametrize(("turn", "least", "most"), [(0.8, 0.4, 0.42), (2.9, 1.2, 2.9 - 0.39)])
def test_missed_direction_is_reported_as_an_angle(kinematics, turn, least, most):
    """Hip yaw is limited to 0.39 rad; a target of toes backward is not taken for toes forward."""
    message = _message(kinematics, orientation=_about((0, 0, 1), turn))
    found = re.search(r"its direction by ([\d.]+) rad", message)
    assert found
    assert least < float(found.group(1)) < most
    assert "left_hip_yaw at its limit 0.3927" in message


@pytest.mark.parametrize("left", [(0.021, 0.135, 0.85), (0.0, 0.1305, 0.69), (0.0, 0.0, 1e6)])
def test_degenerate_target_is_unreachable(kinematics, left):
    assert "pose 0: the left foot" in _message(kinematics, left=left)


def test_first_bad_pose_of_a_batch_is_named(kinematics):
    pelvis = np.tile([0.0, 0.0, 0.85], (6, 1))
    left, right = pelvis * 0 + (0, SIDEWAYS, 0), pelvis * 0 + (0, -SIDEWAYS, 0)
    right[3:, 2] = -1.0
    with pytest.raises(UnreachablePoseError, match="pose 3: the right foot"):
        solve(kinematics, BodyTarget(pelvis), BodyTarget(left), BodyTarget(right))


@pytest.mark.parametrize("position", [np.zeros(3), np.zeros((2, 3))])
def test_wrong_shape_of_a_foot_is_named(kinematics, position):
    good = BodyTarget(np.array([[0.0, SIDEWAYS, -0.85]]))
    with pytest.raises(ShapeError, match=re.escape("right_foot.position must have shape (1, 3)")):
        solve(kinematics, BodyTarget(np.zeros((1, 3))), good, BodyTarget(position))


@pytest.mark.parametrize("name", ["velocity", "angular_velocity"])
def test_non_finite_value_is_named(kinematics, name):
    with pytest.raises(UnreachablePoseError, match=rf"left_foot.{name}\[0\] is not finite"):
        _stand(kinematics, left=(0.0, SIDEWAYS, 0.0), **{name: np.array([[0.0, np.nan, 0.0]])})


def test_zero_quaternion_is_refused(kinematics):
    with pytest.raises(UnreachablePoseError, match=r"left_foot.orientation\[0\] is zero"):
        _stand(kinematics, orientation=np.zeros((1, 4)))


def test_quaternion_is_normalised(kinematics):
    quaternion = _about((0, 0, 1), 0.2)
    one, three = (_stand(kinematics, orientation=scale * quaternion) for scale in (1, 3))
    np.testing.assert_allclose(one.qpos, three.qpos, atol=1e-14)
