"""What the robot believes about its state, under `("estimate", ...)`."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final, cast

from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite

from aslip.transforms.base import CassieTransform, extend_spec, require_keys

ESTIMATE_SIZES: Final = MappingProxyType(
    {
        "height": 1,
        "orientation": 4,
        "velocity": 3,
        "angular_velocity": 3,
        "acceleration": 3,
        "motor_position": 10,
        "motor_velocity": 10,
        "joint_position": 6,
        "joint_velocity": 6,
    }
)
"""Entries of `("estimate", ...)`, 46 numbers in all: height of the pelvis above ground [m],
orientation (wxyz, w >= 0), velocity in the world [m/s], angular velocity in the pelvis frame
[rad/s], acceleration in the pelvis frame without gravity [m/s^2], motors and joints [rad, rad/s].
Frames are those of the robot's own estimator, measured in its public simulator."""

_TRUTH_OF = {
    "orientation": "pelvis_orientation",
    "velocity": "pelvis_velocity",
    "angular_velocity": "pelvis_angular_velocity",
    "acceleration": "pelvis_acceleration",
}


class TrueState(CassieTransform):
    """The truth in place of an estimate: a perfect estimator, to compare others with."""

    def __init__(self) -> None:
        super().__init__(in_keys=["truth"], out_keys=["estimate"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        truth = cast("TensorDict", next_tensordict["truth"])
        estimate = {"height": truth["pelvis_position"][..., 2:]}
        for name in ESTIMATE_SIZES:
            if name != "height":
                estimate[name] = truth[_TRUTH_OF.get(name, name)]
        return next_tensordict.set(
            "estimate", TensorDict(estimate, batch_size=next_tensordict.batch_size)
        )

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ESTIMATE_SIZES`."""
        require_keys(self, observation_spec, [("truth", "pelvis_position")])
        sizes = {("estimate", name): size for name, size in ESTIMATE_SIZES.items()}
        return extend_spec(observation_spec, sizes)
