"""Mirror images of gaits: left and right exchanged."""

from dataclasses import replace

import numpy as np

from aslip.rom.arc import twist_pose
from aslip.rom.gait import Gait
from aslip.rom.motion import Track
from aslip.rom.slip import Mode

_SIGN = np.array([1.0, -1.0, 1.0])


def mirror(gait: Gait) -> Gait:
    """Mirror image of a gait: its command is (v_x, -v_y, -w).

    The image begins at its own left lift-off, which is the gait's right lift-off, half a stride
    later. It is as optimal as the gait and keeps the gait's certificate, with left and right
    exchanged in the names of the margins.
    """
    half = len(gait.time) // 2
    # the first half of the stride, one stride later, follows the second one
    order = np.r_[half : 2 * half, 0 : half + 1]
    later = np.repeat([0.0, gait.stride], [half, half + 1])
    stride_on = twist_pose(gait.command, later)
    to_middle = twist_pose(gait.command, np.full(len(order), gait.stride / 2)).inverse()

    def image(track: Track) -> Track:
        part = Track(track.position[order], track.velocity[order])
        part = part.moved(stride_on).moved(to_middle)
        return Track(part.position * _SIGN, part.velocity * _SIGN)

    feet = image(gait.feet)
    legs = ("leg_force", "set_point", "set_point_velocity", "control")
    swapped = np.array([Mode.RIGHT, Mode.LEFT, Mode.DOUBLE])
    return replace(
        gait,
        # adding 0 turns -0 into 0
        command=gait.command * np.array([1.0, -1.0, -1.0])[: len(gait.command)] + 0.0,
        mode=swapped[gait.mode[order]],
        body=image(gait.body),
        feet=Track(feet.position[:, ::-1], feet.velocity[:, ::-1]),
        certificate=gait.certificate.mirrored(),
        **{name: getattr(gait, name)[order, ::-1] for name in legs},
    )
