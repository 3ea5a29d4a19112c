"""Policy steps in a time; pushes and their text."""

import pytest

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.walking import Push, policy_steps


def test_policy_steps_tolerate_rounding() -> None:
    """Rounding does not add a step; a slightly longer walk takes one more."""
    for steps in range(1, 60):
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
