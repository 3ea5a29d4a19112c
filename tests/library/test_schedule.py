"""Schedules of speeds and their text."""

import pytest

from aslip.errors import ConfigurationError
from aslip.library import Schedule


def test_schedule_holds_each_speed_until_the_next() -> None:
    schedule = Schedule.parse("0:0.0,4:1.0,8:0.5")
    assert schedule == Schedule((0.0, 4.0, 8.0), (0.0, 1.0, 0.5))
    times = [0, 3.97, 4.0, 4 - 1e-9, 7.99, 8.0, 100]
    assert [schedule.at(time) for time in times] == [0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.5]
    assert Schedule.parse("1.5").at(3.0) == 1.5


def test_single_speed_becomes_a_command_of_three_numbers() -> None:
    schedule = Schedule.parse("0:0.5 0 0,4:0.5 0.1 -0.3")
    assert schedule.at(4.5) == (0.5, 0.1, -0.3)
    assert schedule.of_size(3) is schedule
    assert Schedule.parse("0:0.0,4:1.0").of_size(3).commands == ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert Schedule.parse("0.5 0 1").at(2.0) == (0.5, 0.0, 1.0)


def test_stand_is_a_zero_command_with_a_wish() -> None:
    schedule = Schedule.parse("0:0.5 0 0,4: stand,8:0.5 0.1 -0.3")
    assert schedule.commands == ((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), (0.5, 0.1, -0.3))
    assert [schedule.stand_at(time) for time in (0, 3.97, 4.0, 7.9, 8.0)] == [
        False, False, True, True, False
    ]  # fmt: skip
    assert Schedule.parse("stand").of_size(3) == Schedule((0.0,), ((0.0, 0.0, 0.0),), (True,))
    assert Schedule.parse("0:stand,2:1").commands == (0.0, 1.0)
    assert not Schedule.parse("1").stand_at(5.0)
    with pytest.raises(ConfigurationError, match="stand commands"):
        Schedule((0.0, 1.0), (0.0, 0.0), (True,))


@pytest.mark.parametrize(
    "text", ["", "a", "0:1,", "1:0.5", "0:1,0:2", "0:1,3:1,2:1", "0:nan", "0:1:2", "0:sit"]
)
def test_invalid_schedule_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"schedule|times"):
        Schedule.parse(text)
