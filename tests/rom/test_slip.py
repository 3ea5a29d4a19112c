import math

import pytest

from aslip.errors import ConfigurationError
from aslip.rom import SlipParameters


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("stiffness", 0.0),
        ("stiffness", math.nan),
        ("max_leg_length", 0.5),  # below the least one
        ("min_stance_force", 1.0),
        ("heel_offset", -0.1),
        ("swing_ramp", 0.51),
    ],
)
def test_impossible_parameters_are_named(name, value):
    with pytest.raises(ConfigurationError, match=name):
        SlipParameters(**{name: value})
