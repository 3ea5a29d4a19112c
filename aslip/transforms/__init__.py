"""Everything that varies between experiments, as TorchRL transforms.

Each transform reads and writes documented keys of the tensordict. State of an episode is in the
tensordict, not in the transform, so partial resets, worker processes and replay just work.
Transforms that draw random numbers own a generator, which `env.set_seed` seeds.
"""

from aslip.robot import NoiseLevel
from aslip.transforms.action import ActionDelta, LastAction
from aslip.transforms.base import SeededTransform, extend_spec
from aslip.transforms.clock import ClockInput, PhaseClock
from aslip.transforms.command import (
    COMMAND_RATES,
    CommandFilter,
    RandomCommand,
    SpeedCommand,
    VelocityCommand,
)
from aslip.transforms.curriculum import Difficulty
from aslip.transforms.encoders import EncoderOffsets
from aslip.transforms.episode import Fall, FirstStep, LowReward, StaggeredEnds
from aslip.transforms.estimate import (
    ESTIMATE_SIZES,
    ODOMETRY_SIZES,
    PATH_SIZES,
    EstimatedState,
    TrueState,
)
from aslip.transforms.heading import HeadingFrame
from aslip.transforms.noise import ObservationNoise
from aslip.transforms.observation import (
    DIRECTION_TABLE,
    OBSERVATION_TABLE,
    SINGLE_REFERENCE_TABLE,
    AssembleObservation,
)
from aslip.transforms.pushes import RandomPushes
from aslip.transforms.randomise import DYNAMICS_RANGES, WIDE_RANGES, RandomDynamics
from aslip.transforms.reference import (
    Feedforward,
    ReferenceDistance,
    ReferenceInjection,
    ReferenceStart,
)
from aslip.transforms.reward import EpisodeSum, RewardTerm, WeightedReward
from aslip.transforms.standing import StandClock, StandCommand, StandFilter, advance_mode

__all__ = [
    "COMMAND_RATES",
    "DIRECTION_TABLE",
    "DYNAMICS_RANGES",
    "ESTIMATE_SIZES",
    "OBSERVATION_TABLE",
    "ODOMETRY_SIZES",
    "PATH_SIZES",
    "SINGLE_REFERENCE_TABLE",
    "WIDE_RANGES",
    "ActionDelta",
    "AssembleObservation",
    "ClockInput",
    "CommandFilter",
    "Difficulty",
    "EncoderOffsets",
    "EpisodeSum",
    "EstimatedState",
    "Fall",
    "Feedforward",
    "FirstStep",
    "HeadingFrame",
    "LastAction",
    "LowReward",
    "NoiseLevel",
    "ObservationNoise",
    "PhaseClock",
    "RandomCommand",
    "RandomDynamics",
    "RandomPushes",
    "ReferenceDistance",
    "ReferenceInjection",
    "ReferenceStart",
    "RewardTerm",
    "SeededTransform",
    "SpeedCommand",
    "StaggeredEnds",
    "StandClock",
    "StandCommand",
    "StandFilter",
    "TrueState",
    "VelocityCommand",
    "WeightedReward",
    "advance_mode",
    "extend_spec",
]
