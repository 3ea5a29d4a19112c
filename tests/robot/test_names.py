"""Names and their mirror images."""

from __future__ import annotations

import pytest

from aslip.robot import CASSIE, mirror_name


@pytest.mark.parametrize("names", [CASSIE.motor_names, CASSIE.joint_names, CASSIE.spring_names])
def test_left_comes_before_right_and_legs_are_named_alike(names: tuple[str, ...]) -> None:
    half = len(names) // 2
    assert all(name.startswith("left_") for name in names[:half])
    assert tuple(mirror_name(name) for name in names[:half]) == names[half:]


def test_motor_order_is_roll_yaw_pitch_knee_foot() -> None:
    expected = ("hip_roll", "hip_yaw", "hip_pitch", "knee", "foot")
    assert tuple(name.removeprefix("left_") for name in CASSIE.motor_names[:5]) == expected


@pytest.mark.parametrize("name", [*CASSIE.motor_names, "left_right_thing"])
def test_mirroring_twice_changes_nothing(name: str) -> None:
    assert mirror_name(name) != name
    assert mirror_name(mirror_name(name)) == name
