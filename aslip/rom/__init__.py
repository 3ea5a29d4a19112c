"""Actuated-SLIP walking gaits: the model, its optimal gaits and the swing foot profile.

    gait = optimize_gait(1.0)          # 1 m/s, in a fraction of a second
    gait.stride, gait.double_stance    # [s]
    gait.sample(np.linspace(0, 1, 24, endpoint=False)).body_position    # (24, 3) [m]

Imports CasADi, NumPy and SciPy; knows neither the robot nor any learning library.
"""

from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import Mode, energy_function, flow_function, leg_force, leg_function
from aslip.rom.gait import Gait, GaitSample
from aslip.rom.optimize import optimize_gait, optimize_gaits
from aslip.rom.parameters import SlipParameters
from aslip.rom.swing import lift, swing_foot, travel

__all__ = [
    "Certificate",
    "Gait",
    "GaitSample",
    "Mode",
    "SlipParameters",
    "energy_function",
    "flow_function",
    "leg_force",
    "leg_function",
    "lift",
    "optimize_gait",
    "optimize_gaits",
    "swing_foot",
    "travel",
]
