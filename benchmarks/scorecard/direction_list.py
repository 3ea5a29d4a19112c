"""Targets of walks in all directions, with their limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from benchmarks.scorecard.verdicts import Claim


def _falls(name: str, measure: str, digits: int = 0) -> Claim:
    """Target of a count or share that has to be zero for each seed."""
    return Claim(name, measure, at_most=0.0, every_seed=True, digits=digits)


def _survived(name: str, what: str) -> Claim:
    """Target of a sweep of robot or floor."""
    return Claim(name, f"walks survived with {what} [%]", at_least=98.0, digits=1)


TARGETS: Final = (
    Claim("samples", "policy steps of the training [million]", at_most=5.0),
    Claim("time", "time of the training [min]", at_most=90.0, digits=0),
    _falls("falls, walks", "falls per 1000 walks at random commands"),
    Claim(
        "velocity", "error of the mean velocity, mean over commands [m/s]", at_most=0.03, digits=3
    ),
    Claim("velocity, 95 %", "error that 95 % of commands stay below [m/s]", at_most=0.06, digits=3),
    Claim(
        "yaw rate", "error of the mean yaw rate, mean over commands [rad/s]", at_most=0.03, digits=3
    ),
    Claim(
        "yaw rate, 95 %", "error that 95 % of commands stay below [rad/s]", at_most=0.06, digits=3
    ),
    _falls("falls, changes", "falls per 10 000 sudden changes of the command", digits=1),
    _falls("falls, stops", "share of walks with a stop that fall at any time [%]", digits=1),
    _falls("unplanted", "share of these that stand without planting both feet [%]", digits=1),
    Claim("drift", "largest drift of the pelvis in standing [cm]", at_most=1.0),
    Claim("turn", "largest turn of the pelvis in standing [deg]", at_most=0.5),
    _falls("lifted feet", "times a foot is off the ground in standing, of all walks"),
    Claim(
        "stop",
        "time from the stand command at 1 m/s to planted feet, mean over phases [s]",
        at_most=1.0,
    ),
    Claim("power, standing", "positive joint power in standing [W]", at_most=40.0, digits=0),
    Claim(
        "feet, straight",
        "foot placement error, largest mean of 0 to 2 m/s [cm]",
        at_most=3.0,
        digits=1,
    ),
    Claim(
        "feet, turns", "foot placement error, mean over random commands [cm]", at_most=3.5, digits=1
    ),
    _falls(
        "no footsteps", "share of these commands at which it falls or does not step [%]", digits=1
    ),
    Claim(
        "no contact",
        "time without ground contact, largest of 0 to 2 m/s [%]",
        at_most=1.0,
        digits=1,
    ),
    Claim("force", "largest foot force over weight, at 1 and 2 m/s", at_most=1.5),
    Claim("slip", "time at the limit of friction, largest of 0 to 2 m/s [%]", at_most=0.5),
    Claim("power, 1 m/s", "positive joint power over weight and speed", at_most=0.50),
    Claim("power, 2 m/s", "positive joint power over weight and speed", at_most=0.55),
    Claim(
        "pushes, least",
        "largest impulse survived at 1 m/s, worst direction and phase [N s]",
        at_least=30.0,
        digits=1,
    ),
    Claim("pushes, mean", "largest impulse survived at 1 m/s, mean [N s]", at_least=45.0, digits=1),
    _survived("friction", "a floor friction of 0.4 to 1.2"),
    _survived("payload", "0 to 16 kg of payload"),
    _survived("slope", "slopes from -9 to 9 degrees"),
    _survived("delay", "torque delays of 0 to 9 ms"),
    _survived("motors", "motors of 70 to 140 % of their strength"),
    Claim(
        "path",
        "mean distance from the figure of eight [cm]; no value after a fall",
        at_most=10.0,
        digits=1,
    ),
)
"""Targets for the nominal robot, unless the measure says otherwise."""

SWEPT: Final[Mapping[str, tuple[str, float, float]]] = {
    "friction": ("floor_friction", 0.4, 1.2),
    "payload": ("payload", 0.0, 16.0),
    "slope": ("slope", -9.0, 9.0),
    "delay": ("torque_delay", 0.0, 9.0),
    "motors": ("motor_strength", 0.7, 1.4),
}
"""Parameter of a target, and the range of its displayed values that count."""
