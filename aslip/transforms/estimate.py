"""What the robot believes about its state, under `("estimate", ...)` and `("odometry", ...)`."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded

from aslip.estimation import (
    FAULTS,
    Estimate,
    StateEstimator,
    Tracking,
    tracking_size,
)
from aslip.robot import CASSIE, SIDES
from aslip.transforms.base import SeededTransform, extend_spec, require_keys

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
orientation (wxyz, w >= 0) and velocity [m/s] in the heading frame, angular velocity in the pelvis
frame [rad/s], acceleration in the pelvis frame without gravity [m/s^2], motors and joints [rad,
rad/s]. The heading frame has z up against gravity, also on a slope, and x along the robot's
heading, see `HeadingFrame`; otherwise frames are those of the robot's own estimator, measured in
its public simulator."""

ODOMETRY_SIZES: Final = MappingProxyType(
    {
        "pelvis_position": 3,
        "pelvis_orientation": 4,
        "pelvis_velocity": 3,
        "left_foot_position": 3,
        "left_foot_orientation": 4,
        "right_foot_position": 3,
        "right_foot_orientation": 4,
    }
)
"""Entries of `("odometry", ...)`: where pelvis and soles are believed to be, by the names of
`("truth", ...)`, in the heading frame: z up against gravity, also on a slope, x along the robot's
heading. Heights are above the ground below the robot. The way along the ground is counted from the
start, and drifts; it is no part of the policy's input, but rewards can be given on it. The same of
the truth is `("true_odometry", ...)`, see `HeadingFrame`."""

# where the entries of a perfect estimate are
_TRUTH_OF = {name: ("truth", name) for name in ESTIMATE_SIZES} | {
    "height": ("true_odometry", "pelvis_position"),
    "orientation": ("true_odometry", "pelvis_orientation"),
    "velocity": ("true_odometry", "pelvis_velocity"),
    "angular_velocity": ("truth", "pelvis_angular_velocity"),
    "acceleration": ("truth", "pelvis_acceleration"),
}


class _Estimator(SeededTransform):
    """Writes `("estimate", ...)` and `("odometry", ...)`."""

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ESTIMATE_SIZES` and `ODOMETRY_SIZES`."""
        require_keys(self, observation_spec, self.in_keys)
        sizes = {("estimate", name): size for name, size in ESTIMATE_SIZES.items()}
        sizes |= {("odometry", name): size for name, size in ODOMETRY_SIZES.items()}
        return extend_spec(observation_spec, sizes)


class TrueState(_Estimator):
    """The truth in place of an estimate: a perfect estimator, to compare others with.

    Must come after `HeadingFrame`, whose frame it is in.
    """

    def __init__(self) -> None:
        keys: set[NestedKey] = {("true_odometry", name) for name in ODOMETRY_SIZES}
        keys.update(_TRUTH_OF.values())
        super().__init__(in_keys=sorted(keys), out_keys=["estimate", "odometry"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        estimate = {name: cast("Tensor", next_tensordict[key]) for name, key in _TRUTH_OF.items()}
        estimate["height"] = estimate["height"][..., 2:]
        odometry = {name: next_tensordict["true_odometry", name] for name in ODOMETRY_SIZES}
        return next_tensordict.update({"estimate": estimate, "odometry": odometry})


class EstimatedState(_Estimator):
    """State estimated from the packets `("sensors", ...)`; see `aslip.estimation`.

    What the estimator remembers between steps travels as `("estimator", "memory")`, doubles. What
    was wrong with a step's packets is `("estimator", "faults")` (n, 4) bool, in the order of
    `aslip.estimation.FAULTS`; `("estimator", "contact")` (n, 2) tells which feet are loaded. A
    robot that is reset is estimated afresh from its first packets.

    The robot is told its heading, which `HeadingFrame` writes; without, it is the yaw of the first
    packet's orientation.

    Args:
        estimator: another one, or with other settings.
    """

    def __init__(self, estimator: StateEstimator | None = None) -> None:
        super().__init__(
            in_keys=[("sensors", name) for name in CASSIE.packet_sizes],
            out_keys=["estimate", "odometry", "estimator"],
        )
        self.estimator = StateEstimator() if estimator is None else estimator

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory = cast("torch.Tensor", tensordict["estimator", "memory"])
        tracking = Tracking.from_rows(memory.numpy(), self.estimator.robot)
        heading = next_tensordict.get("heading", None)
        if heading is not None:
            tracking.heading = heading[:, 0].double().numpy()
        estimate = self.estimator.update(tracking, self._packets(next_tensordict))
        return next_tensordict.update(estimate_entries(tracking, estimate))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL takes only the rows that are reset; to start the others would be for nothing
        mask = tensordict.get("_reset", None)
        rows = torch.ones(tensordict_reset.batch_size, dtype=torch.bool)
        if mask is not None:
            rows = mask.reshape(-1)
        packets = self._packets(tensordict_reset)[rows.numpy()]
        heading = tensordict_reset.get("heading", None)
        if heading is not None:
            heading = heading[rows].double().numpy()
        entries = estimate_entries(*self.estimator.start(packets, heading))
        if rows.all():
            return tensordict_reset.update(entries)
        started = TensorDict(entries, batch_size=[int(rows.sum())])
        for key, value in started.items(True, True):
            full = torch.zeros(len(rows), *value.shape[1:], dtype=value.dtype)
            full[rows] = value
            tensordict_reset.set(key, full)
        return tensordict_reset

    def _packets(self, tensordict: TensorDictBase) -> np.ndarray:
        """(n, w, 42) the sensors' packets."""
        entries = [cast("torch.Tensor", tensordict[key]) for key in self.in_keys]
        return torch.cat(entries, dim=-1).double().numpy()

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ESTIMATE_SIZES`, `ODOMETRY_SIZES`, and the estimator's own."""
        spec = super().transform_observation_spec(observation_spec)
        shape, size = tuple(spec.shape), tracking_size(self.estimator.robot)
        spec["estimator"] = Composite(
            memory=Unbounded(torch.Size((*shape, size)), dtype=torch.float64),
            faults=Binary(shape=torch.Size((*shape, len(FAULTS))), dtype=torch.bool),
            contact=Binary(shape=torch.Size((*shape, len(SIDES))), dtype=torch.bool),
            shape=spec.shape,
        )
        return spec


def estimate_entries(tracking: Tracking, estimate: Estimate) -> dict[str, dict[str, torch.Tensor]]:
    """Entries of an estimate in a tensordict, by the groups that `EstimatedState` writes."""
    odometry = {
        "pelvis_position": estimate.position,
        "pelvis_orientation": estimate.orientation,
        "pelvis_velocity": estimate.velocity,
    }
    for i, side in enumerate(SIDES):
        odometry[f"{side}_foot_position"] = estimate.foot_position[:, i]
        odometry[f"{side}_foot_orientation"] = estimate.foot_orientation[:, i]
    single = {
        "estimate": {name: getattr(estimate, name) for name in ESTIMATE_SIZES},
        "odometry": odometry,
    }
    entries = {
        group: {name: torch.tensor(value, dtype=torch.float32) for name, value in values.items()}
        for group, values in single.items()
    }
    entries["estimator"] = {
        "memory": torch.from_numpy(tracking.to_rows()),
        "faults": torch.from_numpy(estimate.faults),
        "contact": torch.tensor(estimate.contact),
    }
    return entries
