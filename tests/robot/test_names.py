"""Names and their mirror images."""

from __future__ import annotations

import pytest

from aslip.robot import CASSIE, mirror_name


@pytest.mark.parametrize("names", [CASSIE.motor_names, CASSIE.joint_names, CASSIE.spring_names])
def test_left_comes_before_right_and_legs_are_named_alike(names: tuple[str, ...]) -> None:
    half = len(names) // 2
    assert all(name.startswith("left_") for name in names[:half])
    assert tuple(mirror_name(name) for name in names[:half]) == names[half:]


@pytest.mark.parametrize("name", [*CASSIE.motor_names, "left_right_thing"])
def test_mirroring_twice_changes_nothing(name: str) -> None:
    assert mirror_name(name) != name
    assert mirror_name(mirror_name(name)) == name
