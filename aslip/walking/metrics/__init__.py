"""Metrics of a walk: pure functions of arrays, each with its definition and source.

Arrays have time first. A "stance" is a row of two sample indices, first and one past the last.
"""

from aslip.walking.metrics.contact import (
    duty_factor,
    merge_short,
    stances,
    step_frequency,
    touchdown_times,
)
from aslip.walking.metrics.effort import action_roughness, cost_of_transport, jerk
from aslip.walking.metrics.footsteps import Footsteps, Placement, footsteps, placement
from aslip.walking.metrics.force import (
    ForceProfile,
    dip_ratio,
    force_profile,
    humps,
    mean_over_strides,
)
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
    "cost_of_transport",
    "dip_ratio",
    "duty_factor",
    "footsteps",
    "force_profile",
    "humps",
    "jerk",
    "leg_length_correlation",
    "mean_over_strides",
    "merge_short",
    "placement",
    "root_mean_square",
    "stances",
    "step_frequency",
    "step_response",
    "stride_average",
    "touchdown_spike",
    "touchdown_times",
]
