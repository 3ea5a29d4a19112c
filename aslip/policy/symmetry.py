"""Left-right mirror images of what the policy sees and does.

Cassie, its gaits and the reward are symmetric about the plane of walking: mirror a state and an
action, and nearly the mirrored next state follows (the pelvis' centre of mass is 0.3 mm off). The
maps are built from the names of the observation's
entries and the motors, and hold for any table of such entries.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import JOINT_NAMES, MOTOR_NAMES, mirror_name
from aslip.transforms import OBSERVATION_TABLE

# mirrored at the xz plane: vectors turn their y; axial vectors (rates of rotation, and a
# quaternion's vector part) turn their x and z
_VECTOR = (1.0, -1.0, 1.0)
_AXIAL = (-1.0, 1.0, -1.0)
_QUATERNION = (1.0, -1.0, 1.0, -1.0)
# hinges about the walking direction and the vertical turn the other way on the other leg
_TURNING = ("hip_roll", "hip_yaw")

_SIGNS = {
    "height": (1.0,),
    "heading": (-1.0,),
    "orientation": _QUATERNION,
    "angular_velocity": _AXIAL,
    "velocity": _VECTOR,
    "acceleration": _VECTOR,
    "body_position": _VECTOR,
    "body_velocity": _VECTOR,
    "left_foot_position": _VECTOR,
    "left_foot_velocity": _VECTOR,
    "right_foot_position": _VECTOR,
    "right_foot_velocity": _VECTOR,
    "command": (1.0,),
    # the other leg's turn is half a stride later
    "sin": (-1.0,),
    "cos": (-1.0,),
}


class Mirror(nn.Module):
    """A fixed permutation and signs of the last dimension; its own inverse.

    Args:
        names: one name an element.
        partners: for each element the name of the element it becomes.
        signs: for each element the sign it gets.

    Raises:
        ConfigurationError: a name comes twice, or the mirror image of the mirror image is another.
    """

    index: Tensor
    sign: Tensor

    def __init__(
        self, names: Sequence[str], partners: Sequence[str], signs: Sequence[float]
    ) -> None:
        super().__init__()
        place = {name: i for i, name in enumerate(names)}
        lacking = sorted(set(partners) - set(place))
        if len(place) < len(names) or lacking:
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ConfigurationError(
                f"no mirror image: {f'{twice} come twice' if twice else f'there is no {lacking}'}"
            )
        index = torch.tensor([place[partner] for partner in partners])
        # these follow from the names, so that files need not hold them
        self.register_buffer("index", index, persistent=False)
        self.register_buffer("sign", torch.tensor(signs), persistent=False)

    def forward(self, values: Tensor) -> Tensor:
        """Mirror image of (*b, k) values.

        Raises:
            ShapeError: there is another number of values.
        """
        check_size(values, len(self.index))
        return values[..., self.index] * self.sign


def check_size(values: Tensor, size: int) -> None:
    """Check that what a policy is shown, (*b, size), is what it reads.

    Raises:
        ShapeError: there is another number of values.
    """
    if values.shape[-1] != size:
        raise ShapeError(
            f"a policy that reads {size} numbers was shown {values.shape[-1]}: it belongs to"
            " another stack of transforms"
        )


class Symmetrised(nn.Module):
    r"""A net that treats left and right alike, :math:`(f(x) + M_y f(M_x x)) / 2`.

    What it learns of one leg it knows of the other (Abdolhosseini et al. 2019).

    Args:
        net: the net f.
        inputs: mirror of its input.
        outputs: mirror of its output; by default that does not change, as a value.
    """

    def __init__(self, net: nn.Module, inputs: Mirror, outputs: Mirror | None = None) -> None:
        super().__init__()
        self.net, self.inputs = net, inputs
        self.outputs = nn.Identity() if outputs is None else outputs

    def forward(self, values: Tensor) -> Tensor:
        """Output for (*b, k) values."""
        plain, image = self.net(torch.stack([values, self.inputs(values)]))
        return (plain + self.outputs(image)) / 2


def action_mirror() -> Mirror:
    """Mirror of a (*b, 10) action or of motor angles."""
    return Mirror(MOTOR_NAMES, [mirror_name(name) for name in MOTOR_NAMES], _turns(MOTOR_NAMES))


def observation_mirror(table: Sequence[NestedKey] = OBSERVATION_TABLE) -> Mirror:
    """Mirror of an observation.

    Args:
        table: keys of its entries, in order.

    Raises:
        UnknownNameError: it is not known how an entry's mirror image looks.
        ConfigurationError: an entry comes twice, or one of the left has none of the right.
    """
    names: list[str] = []
    partners: list[str] = []
    signs: list[float] = []
    for key in table:
        entry = key if isinstance(key, str) else str(key[-1])
        parts, entry_signs = _entry(entry)
        swapped = mirror_name(entry) if entry.startswith(("left_", "right_")) else entry
        # entries of two sources may have the same name
        source = "" if isinstance(key, str) else "/".join(map(str, key[:-1]))
        names += [f"{source}/{entry}/{part}" for part in parts]
        partners += [f"{source}/{swapped}/{_mirrored_part(part)}" for part in parts]
        signs += entry_signs
    return Mirror(names, partners, signs)


def _entry(entry: str) -> tuple[Sequence[str], list[float]]:
    """Names of an entry's elements, and their signs."""
    for group, members in (("motor_", MOTOR_NAMES), ("joint_", JOINT_NAMES)):
        if entry.startswith(group):
            return members, _turns(members)
    if entry not in _SIGNS:
        raise UnknownNameError(
            f"no mirror image is known for {entry!r}, known are motor_*, joint_* and"
            f" {list(_SIGNS)}; a policy that is not symmetric (--no-symmetric) needs none"
        )
    return [str(i) for i in range(len(_SIGNS[entry]))], list(_SIGNS[entry])


def _turns(names: Sequence[str]) -> list[float]:
    return [-1.0 if name.endswith(_TURNING) else 1.0 for name in names]


def _mirrored_part(part: str) -> str:
    return part if part.isdecimal() else mirror_name(part)
