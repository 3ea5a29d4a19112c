"""Reduced-order models and their motions: actuated SLIP, linear inverted pendulum, recorded walks.

    gait = optimize_gait(1.0)          # 1 m/s, in a fraction of a second
    turn = optimize_gait([0.5, 0.2, 1.0])    # forward, sideways [m/s], yaw rate [rad/s]
    stop, start = optimize_transitions(optimize_gait([0.0, 0.0, 0.0]))
    gait.stride, gait.double_stance    # [s]
    gait.sample(np.linspace(0, 1, 24, endpoint=False)).body.position    # (24, 3) [m]

Sampling a motion needs NumPy and SciPy only; CasADi is imported when a gait is optimised. The
package imports neither the robot nor a learning library.
"""

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.rom.certificate import Certificate
    from aslip.rom.gait import Gait, GaitSample
    from aslip.rom.mirror import mirror
    from aslip.rom.motion import (
        PHASE_SAMPLES,
        Angle,
        Motion,
        MotionSample,
        SampledMotion,
        Track,
    )
    from aslip.rom.optimize import optimize_gait, optimize_gaits, optimize_transitions
    from aslip.rom.pendulum import PendulumWalk, pendulum_walks
    from aslip.rom.slip import DIRECTION_MODEL, Mode, Objective, SlipParameters
    from aslip.rom.standing import Standing, Transition

_FILES = {
    "certificate": ["Certificate"],
    "gait": ["Gait", "GaitSample"],
    "mirror": ["mirror"],
    "motion": ["PHASE_SAMPLES", "Angle", "Motion", "MotionSample", "SampledMotion", "Track"],
    "optimize": ["optimize_gait", "optimize_gaits", "optimize_transitions"],
    "pendulum": ["PendulumWalk", "pendulum_walks"],
    "slip": ["DIRECTION_MODEL", "Mode", "Objective", "SlipParameters"],
    "standing": ["Standing", "Transition"],
}

__all__ = [
    "DIRECTION_MODEL",
    "PHASE_SAMPLES",
    "Angle",
    "Certificate",
    "Gait",
    "GaitSample",
    "Mode",
    "Motion",
    "MotionSample",
    "Objective",
    "PendulumWalk",
    "SampledMotion",
    "SlipParameters",
    "Standing",
    "Track",
    "Transition",
    "mirror",
    "optimize_gait",
    "optimize_gaits",
    "optimize_transitions",
    "pendulum_walks",
]

__getattr__, __dir__ = attach(__name__, _FILES)
