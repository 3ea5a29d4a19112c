"""The numbers of the robot hang together."""

from __future__ import annotations

import numpy as np
import pytest

from aslip import robot

PER_MOTOR = (
    "GEAR",
    "MOTOR_NO_LOAD_SPEED",
    "MOTOR_TORQUE_LIMIT",
    "PD_DAMPING",
    "PD_STIFFNESS",
)


@pytest.mark.parametrize("name", PER_MOTOR)
def test_both_legs_have_the_same_read_only_motors(name: str) -> None:
    values = getattr(robot, name)
    assert values.shape == (10,)
    np.testing.assert_array_equal(values[:5], values[5:])
    assert (values > 0).all()
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 1.0


def test_joint_torque_and_no_load_speed_are_the_motors_through_the_gear() -> None:
    torque = robot.MOTOR_TORQUE_LIMIT * robot.GEAR
    np.testing.assert_allclose(torque[:5], [112.5, 112.5, 195.2, 195.2, 45.0])
    speed = robot.MOTOR_NO_LOAD_SPEED / robot.GEAR
    np.testing.assert_allclose(speed[:5], [12.147, 12.147, 8.508, 8.508, 11.519], atol=1e-3)


def test_a_policy_step_is_sixty_substeps_and_thirty_milliseconds() -> None:
    assert robot.SUBSTEPS == 60
    assert pytest.approx(0.030) == robot.POLICY_PERIOD
    assert robot.PHYSICS_TIMESTEP == 0.0005
