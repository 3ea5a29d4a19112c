import math

import pytest

from aslip.errors import ConfigurationError
from aslip.rom import SlipParameters


def test_default_parameters_are_those_of_table_1():
    """Table I: m = 30 kg, k = 3000 N/m, b = 2 Ns/m, I_m = 10 kg, g = 9.81 m/s^2."""
    p = SlipParameters()
    assert (p.mass, p.stiffness, p.damping) == (30.0, 3000.0, 2.0)
    assert (p.actuator_inertia, p.gravity) == (10.0, 9.81)


def test_default_swing_clearance_is_the_papers():
    """Sec. III-A: "the 0.2 m specified vertical clearance height"."""
    assert SlipParameters().swing_clearance == 0.2
    assert SlipParameters().swing_ramp is None


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_parameters_must_be_positive_and_finite(value):
    with pytest.raises(ConfigurationError, match="stiffness"):
        SlipParameters(stiffness=value)


def test_lower_bounds_must_be_below_upper_bounds():
    with pytest.raises(ConfigurationError, match="max_leg_length"):
        SlipParameters(max_leg_length=0.5)


@pytest.mark.parametrize("value", [-0.1, 1.0, math.nan, math.inf])
def test_least_stance_force_must_be_a_share_of_body_weight(value):
    with pytest.raises(ConfigurationError, match=r"min_stance_force .* below 1 body weight"):
        SlipParameters(min_stance_force=value)


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_offset_of_the_heels_must_not_be_negative(value):
    with pytest.raises(ConfigurationError, match="heel_offset must be at least 0 and finite"):
        SlipParameters(heel_offset=value)


@pytest.mark.parametrize("value", [0.0, -0.1, 0.51, float("nan")])
def test_ramp_of_the_swing_is_checked(value: float) -> None:
    with pytest.raises(ConfigurationError, match="swing_ramp"):
        SlipParameters(swing_ramp=value)
