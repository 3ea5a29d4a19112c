"""Metrics of a walk: pure functions of arrays, each with its definition and source.

Arrays have time first. A "stance" is a row of two sample indices, first and one past the last.
"""

from aslip.walking.metrics.contact import (
    airborne_share,
    duty_factor,
    longest_airborne,
    merge_short,
    slip_distance,
    stances,
    step_frequency,
    touchdown_times,
)
from aslip.walking.metrics.directions import mean_twist, tracking_errors
from aslip.walking.metrics.effort import action_roughness, cost_of_transport, jerk, mechanical_power
from aslip.walking.metrics.footsteps import Footsteps, Placement, footsteps, placement
from aslip.walking.metrics.force import (
    ForceProfile,
    dip_ratio,
    force_profile,
    friction_limit_share,
    humps,
    largest_force,
    mean_over_strides,
    touchdown_impact,
)
from aslip.walking.metrics.standing import drift, lifted_feet, planting_time, turned
from aslip.walking.metrics.tracking import (
    StepResponse,
    leg_length_correlation,
    root_mean_square,
    step_response,
    stride_average,
    touchdown_spike,
)

__all__ = [
    "Footsteps",
    "ForceProfile",
    "Placement",
    "StepResponse",
    "action_roughness",
    "airborne_share",
    "cost_of_transport",
    "dip_ratio",
    "drift",
    "duty_factor",
    "footsteps",
    "force_profile",
    "friction_limit_share",
    "humps",
    "jerk",
    "largest_force",
    "leg_length_correlation",
    "lifted_feet",
    "longest_airborne",
    "mean_over_strides",
    "mean_twist",
    "mechanical_power",
    "merge_short",
    "placement",
    "planting_time",
    "root_mean_square",
    "slip_distance",
    "stances",
    "step_frequency",
    "step_response",
    "stride_average",
    "touchdown_impact",
    "touchdown_spike",
    "touchdown_times",
    "tracking_errors",
    "turned",
]
