"""Names of motors, joints and sites in the order used everywhere: left before right."""

from __future__ import annotations

from typing import Final, Literal

from aslip.errors import UnknownNameError

Side = Literal["left", "right"]

SIDES: Final[tuple[Side, Side]] = ("left", "right")

MOTOR_NAMES: Final = tuple(
    f"{side}_{joint}"
    for side in SIDES
    for joint in ("hip_roll", "hip_yaw", "hip_pitch", "knee", "foot")
)
"""The ten motors; each drives the joint of the same name."""

JOINT_NAMES: Final = tuple(
    f"{side}_{joint}" for side in SIDES for joint in ("shin", "tarsus", "foot")
)
"""The six joints with an encoder on the joint itself; the foot has both encoders."""

SPRING_NAMES: Final = tuple(
    f"{side}_{joint}" for side in SIDES for joint in ("shin", "heel_spring")
)
"""The four leaf springs, modelled as hinges with stiffness."""


def foot_site(side: Side) -> str:
    """Name of the site at the centre of a foot's sole (x to the toes, z up when level)."""
    return f"{side}_foot"


def mirror_name(name: str) -> str:
    """The same part on the other leg.

    Raises:
        UnknownNameError: the name belongs to neither leg.
    """
    for side, other in (("left", "right"), ("right", "left")):
        if name.startswith(f"{side}_"):
            return name.replace(side, other, 1)
    raise UnknownNameError(f"{name!r} belongs to no leg; names start with 'left_' or 'right_'")
