"""Error messages for targets out of reach and malformed targets."""

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


def test_target_too_far_is_reported_with_what_is_missed(kinematics):
    _stand(kinematics, left=(0.0, SIDEWAYS, -0.27))
    found = re.search(r"ends ([\d.]+) m and ", _message(kinematics, left=(0.0, SIDEWAYS, -0.6)))
    assert found
    # the stretched leg lacks 0.32 m with its joint limits, which Newton's method leaves out
    assert 0.25 < float(found.group(1)) < 0.35


@pytest.mark.parametrize(
    ("joint", "pose"),
    [
        ("left_knee would be at -0.6304", {"left": (0.0, SIDEWAYS, -0.28)}),
        ("left_tarsus would be at 3.0004", {"left": (0.0, SIDEWAYS, 0.5)}),
        ("0.4996 rad, and must be from -0.3927 to", {"orientation": _about((0, 0, 1), 0.5)}),
    ],
)
def test_limiting_joint_is_named(kinematics, joint, pose):
    message = _message(kinematics, **pose)
    assert message.startswith("pose 0: the left foot cannot get to its target: left_")
    assert joint in message


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


def test_zero_quaternion_is_refused(kinematics):
    with pytest.raises(UnreachablePoseError, match=r"left_foot.orientation\[0\] is zero"):
        _stand(kinematics, orientation=np.zeros((1, 4)))


def test_quaternion_is_normalised(kinematics):
    quaternion = _about((0, 0, 1), 0.2)
    one, three = (_stand(kinematics, orientation=scale * quaternion) for scale in (1, 3))
    np.testing.assert_allclose(one.qpos, three.qpos, atol=1e-14)


@pytest.mark.parametrize("left", [(0.021, 0.135, 0.85), (0.0, 0.1305, 0.69), (0.0, 0.0, 1e6)])
def test_degenerate_target_is_unreachable(kinematics, left):
    assert "pose 0: the left foot" in _message(kinematics, left=left)


@pytest.mark.parametrize("name", ["velocity", "angular_velocity"])
def test_non_finite_value_is_named(kinematics, name):
    with pytest.raises(UnreachablePoseError, match=rf"left_foot.{name}\[0\] is not finite"):
        _stand(kinematics, left=(0.0, SIDEWAYS, 0.0), **{name: np.array([[0.0, np.nan, 0.0]])})
