"""Left-right mirror images of observations and actions.

Robot, gaits and reward are symmetric about the plane of walking: a mirrored state and action lead
to the mirrored next state (nearly: Cassie's pelvis is 0.3 mm off centre). The maps
are built from the names of the observation's entries and of the motors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE, mirror_name
from aslip.transforms import OBSERVATION_TABLE

# mirror at the xz plane: vectors flip the sign of y; axial vectors (angular velocities, the vector
# part of a quaternion) flip the signs of x and z
_VECTOR = (1.0, -1.0, 1.0)
_AXIAL = (-1.0, 1.0, -1.0)
_QUATERNION = (1.0, -1.0, 1.0, -1.0)
# joints about the forward and the vertical axis have the opposite sign on the other leg
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
    "body_heading": (-1.0,),
    "left_foot_heading": (-1.0,),
    "right_foot_heading": (-1.0,),
    # commands of one axis; those of three mirror as filtered ones do
    "command": (1.0,),
    "filtered_command": (1.0, -1.0, -1.0),
    "path_error": (1.0, -1.0),
    "step": (*_VECTOR, 1.0, -1.0),
    "direction": (1.0, -1.0),
    # mirroring shifts the phase by half a stride, which flips the signs of sine and cosine
    "sin": (-1.0,),
    "cos": (-1.0,),
}
_PER_MOTOR = ("action", "last_action")


class Mirror(nn.Module):
    """Permutation and sign changes of the last dimension; the map is its own inverse.

    Args:
        names: name of each element.
        partners: name of the mirror partner of each element.
        signs: sign of each element.

    Raises:
        ConfigurationError: a name is repeated, or a partner is missing.
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
            reason = f"{twice} are repeated" if twice else f"{lacking} are missing"
            raise ConfigurationError(f"the observation has no mirror image: {reason}")
        index = torch.tensor([place[partner] for partner in partners])
        # derived from the names, so not stored in files
        self.register_buffer("index", index, persistent=False)
        self.register_buffer("sign", torch.tensor(signs), persistent=False)

    def forward(self, values: Tensor) -> Tensor:
        """Mirror image of (*b, k) values.

        Raises:
            ShapeError: the last dimension is not k.
        """
        check_size(values, len(self.index))
        return values[..., self.index] * self.sign


def check_size(values: Tensor, size: int) -> None:
    """Check that an observation (*b, size) has the size that a policy reads.

    Raises:
        ShapeError: it has another size.
    """
    if values.shape[-1] != size:
        raise ShapeError(
            f"the policy reads {size} numbers, the observation has {values.shape[-1]}: the policy"
            " was trained on another stack of transforms"
        )


class Symmetrised(nn.Module):
    r"""Network that is equivariant to the mirror, :math:`(f(x) + M_y f(M_x x)) / 2`.

    What one leg experiences also trains the other (Abdolhosseini et al. 2019).

    Args:
        net: the network f.
        inputs: mirror of its input.
        outputs: mirror of its output; by default the output is invariant, as a value function is.
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
    """Mirror of an action (*b, 10) or of motor angles."""
    return Mirror(
        CASSIE.motor_names,
        [mirror_name(name) for name in CASSIE.motor_names],
        _turns(CASSIE.motor_names),
    )


def observation_mirror(
    table: Sequence[NestedKey] = OBSERVATION_TABLE,
    signs: Mapping[str, Sequence[float]] | None = None,
) -> Mirror:
    """Mirror of an observation.

    An entry `left_x` becomes `right_x`. `motor_*` and `joint_*`, `action` and `last_action` have
    one element per motor or joint.

    Args:
        table: keys of the observation's entries, in order.
        signs: signs of the mirror images of other entries, by name, one per element.

    Raises:
        UnknownNameError: the mirror image of an entry is unknown.
        ConfigurationError: an entry is repeated, or an entry of one side lacks its partner.
    """
    names: list[str] = []
    partners: list[str] = []
    all_signs: list[float] = []
    for key in table:
        entry = key if isinstance(key, str) else str(key[-1])
        parts, entry_signs = _entry(entry, {**_SIGNS, **(signs or {})})
        swapped = mirror_name(entry) if entry.startswith(("left_", "right_")) else entry
        # entries of different groups may have the same name
        source = "" if isinstance(key, str) else "/".join(map(str, key[:-1]))
        names += [f"{source}/{entry}/{part}" for part in parts]
        partners += [f"{source}/{swapped}/{_mirrored_part(part)}" for part in parts]
        all_signs += entry_signs
    return Mirror(names, partners, all_signs)


def _entry(entry: str, known: Mapping[str, Sequence[float]]) -> tuple[Sequence[str], list[float]]:
    """Names of an entry's elements, and their signs."""
    if entry in known:
        signs = [float(sign) for sign in known[entry]]
        return [str(i) for i in range(len(signs))], signs
    if entry.startswith("motor_") or entry in _PER_MOTOR:
        return CASSIE.motor_names, _turns(CASSIE.motor_names)
    if entry.startswith("joint_"):
        return CASSIE.joint_names, _turns(CASSIE.joint_names)
    raise UnknownNameError(
        f"the mirror image of {entry!r} is unknown: give its signs, PolicyShape(mirror_signs="
        f"{{{entry!r}: (1.0, -1.0, ...)}}), or train without symmetry (--no-symmetric); known are"
        f" motor_*, joint_*, {list(_PER_MOTOR)} and {list(known)}"
    )


def _turns(names: Sequence[str]) -> list[float]:
    return [-1.0 if name.endswith(_TURNING) else 1.0 for name in names]


def _mirrored_part(part: str) -> str:
    return part if part.isdecimal() else mirror_name(part)
