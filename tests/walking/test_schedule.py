"""Schedules of speeds, pushes, and their text."""

from __future__ import annotations

import pytest

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.walking import Push, Schedule, policy_steps


def test_schedule_holds_each_speed_until_the_next() -> None:
    schedule = Schedule.parse("0:0.0,4:1.0,8:0.5")
    assert schedule == Schedule((0.0, 4.0, 8.0), (0.0, 1.0, 0.5))
    times = [0, 3.97, 4.0, 4 - 1e-9, 7.99, 8.0, 100]
    assert [schedule.at(time) for time in times] == [0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.5]
    assert Schedule.parse("1.5").at(3.0) == 1.5


@pytest.mark.parametrize(
    "text", ["", "a", "0:1,", "1:0.5", "0:1,0:2", "0:1,3:1,2:1", "0:nan", "0:1:2"]
)
def test_refuses_invalid_schedule(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"schedule|times"):
        Schedule.parse(text)


@pytest.mark.parametrize("steps", range(1, 60))
def test_policy_steps_tolerate_rounding(steps: int) -> None:
    """Rounding does not add a step; a slightly longer walk takes one more."""
    for time in (steps * CASSIE.policy_period, float(f"{steps * 0.03:.2f}")):
        assert policy_steps(time) == steps
    assert policy_steps(steps * CASSIE.policy_period + 1e-4) == steps + 1


def test_parses_push() -> None:
    assert Push.parse("2:0,60,-5") == Push(2.0, (0.0, 60.0, -5.0))
    assert Push.parse("2:0,60,-5:0.3") == Push(2.0, (0.0, 60.0, -5.0), 0.3)


@pytest.mark.parametrize("text", ["", "1", "1:2", "1:1,2", "1:1,2,3:0", "1:1,2,nan", "1:1,2,3:1:1"])
def test_refuses_invalid_push(text: str) -> None:
    with pytest.raises(ConfigurationError, match="push is"):
        Push.parse(text)
