"""State of the robot for policy and rewards: estimated, or the simulator's truth."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded

from aslip.base.arrays import Array, is_numpy
from aslip.errors import ConfigurationError
from aslip.estimation import FAULTS, Estimate, StateEstimator, Tracking, tracking_size
from aslip.robot import CASSIE, SIDES
from aslip.transforms.base import SeededTransform, extend_spec, require_keys, reset_rows, spread
from aslip.transforms.path import advance_frame, place_in_path
from aslip.transforms.rotation import rotate_about_vertical

ESTIMATE_SIZES: Final = MappingProxyType(CASSIE.estimate_sizes)
"""Entries of `("estimate", ...)`, 46 numbers in all: height of the pelvis above ground [m],
orientation (wxyz, w >= 0) and velocity [m/s] in the heading frame, angular velocity in the pelvis
frame [rad/s], acceleration in the pelvis frame without gravity [m/s^2], motors and joints [rad,
rad/s]. The heading frame has z up against gravity, also on a slope, and x along the entry
`heading`, the direction that counts as straight ahead, which does not turn with the robot, see
`HeadingFrame`; otherwise frames are those of the robot's own estimator, measured in its public
simulator."""

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
"""Entries of `("odometry", ...)`: estimated poses of pelvis and soles, with the names of
`("truth", ...)`, in the heading frame: z up against gravity, also on a slope, x along the entry
`heading`. Heights are above the ground below the robot, or on ground of any height above that of
the start, and then drift (`FilterNoise.ground`). Distances along the ground count from the start,
and drift; the policy does not see them, but rewards can use them. `HeadingFrame` writes
perfect odometry as `("true_odometry", ...)`."""

PATH_SIZES: Final = MappingProxyType({"origin": 3, "path_error": 2})
"""Further entries of `("odometry", ...)` if the frame moves along the commanded path: its origin
[m, frame of the IMU's attitude], and forward and sideways distance of the pelvis from it [m]."""

# keys of the entries of a perfect estimate
_TRUTH_OF = {name: ("truth", name) for name in ESTIMATE_SIZES} | {
    "height": ("true_odometry", "pelvis_position"),
    "orientation": ("true_odometry", "pelvis_orientation"),
    "velocity": ("true_odometry", "pelvis_velocity"),
    "angular_velocity": ("truth", "pelvis_angular_velocity"),
    "acceleration": ("truth", "pelvis_acceleration"),
}
_GROUND, _ORIGIN = ("truth", "ground_height"), ("true_odometry", "origin")


class _Estimator(SeededTransform):
    """Base class of transforms that write estimate and odometry under their first two keys."""

    _path = False

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ESTIMATE_SIZES` and `ODOMETRY_SIZES`."""
        require_keys(self, observation_spec, self.in_keys)
        along = PATH_SIZES if self._path else {}
        groups = (ESTIMATE_SIZES, {**ODOMETRY_SIZES, **along})
        for key, sizes in zip(self.out_keys, groups, strict=False):
            group = Composite(shape=observation_spec.shape)
            observation_spec[key] = extend_spec(group, sizes)
        return observation_spec


class TrueState(_Estimator):
    """Write the truth as the estimate, as a perfect estimator would.

    Reads `("truth", ...)` and `("true_odometry", ...)`, so it must come after `HeadingFrame`.
    """

    def __init__(self) -> None:
        keys: set[NestedKey] = {("true_odometry", name) for name in ODOMETRY_SIZES}
        keys.update([*_TRUTH_OF.values(), _GROUND, _ORIGIN])
        super().__init__(sorted(keys, key=str), ["estimate", "odometry"])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ODOMETRY_SIZES` and, along a path, of `PATH_SIZES`."""
        self._path = observation_spec.get(("true_odometry", "path_error"), None) is not None
        return super().transform_observation_spec(observation_spec)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        estimate = {name: cast("Tensor", next_tensordict[key]) for name, key in _TRUTH_OF.items()}
        ground, origin = (cast("Tensor", next_tensordict[key]) for key in (_GROUND, _ORIGIN))
        estimate["height"] = estimate["height"][..., 2:] - (ground - origin[..., 2:])
        true = cast("TensorDictBase", next_tensordict["true_odometry"])
        along = PATH_SIZES if "path_error" in true else {}
        odometry = {name: true[name] for name in (*ODOMETRY_SIZES, *along)}
        for key, entries in zip(self.out_keys, (estimate, odometry), strict=True):
            next_tensordict.set(key, TensorDict(entries, next_tensordict.batch_size))
        return next_tensordict


class EstimatedState(_Estimator):
    """Estimate the state from the packets of the sensors; see `aslip.estimation`.

    Writes further entries: `("estimator", "memory")`, the estimator's state between steps in double
    precision; `("estimator", "faults")` (n, 4) bool, faults of the packets in the order of
    `aslip.estimation.FAULTS`; `("estimator", "contact")` (n, 2), loaded feet. After a reset the
    estimate starts afresh from the robot's first packets.

    The yaw that counts as straight ahead is `heading` (n, 1) [rad], as `HeadingFrame` writes it;
    without this entry, it is that of the first packet's orientation.

    With a `command_key` the odometry moves along the path of that command, as the true one of
    `HeadingFrame` does; it has the entries of `PATH_SIZES`, too.

    Args:
        estimator: state estimator of Cassie.
        command_key: key of the command (n, c) whose path the odometry follows; None for odometry
            from the start.
        mode_key: key of the mode (n, 1) of robots with a stand command, as `StandClock` writes it;
            stops move the origin of the odometry to the pelvis.
    """

    needs_env = "the estimator tracks robots from their resets on"

    def __init__(
        self,
        estimator: StateEstimator | None = None,
        *,
        command_key: NestedKey | None = None,
        mode_key: NestedKey | None = None,
    ) -> None:
        keys = [("sensors", name) for name in CASSIE.packet_sizes]
        super().__init__(in_keys=keys, out_keys=["estimate", "odometry", "estimator"])
        self._command_key, self._mode_key = command_key, mode_key
        self._path = command_key is not None
        self.estimator = StateEstimator() if estimator is None else estimator

    def move(self, place: torch.device) -> None:
        """See `SeededTransform.move`; the package's estimator becomes a `DeviceEstimator`.

        Raises:
            ConfigurationError: the estimator is another one, and takes no tensors.
        """
        super().move(place)
        own = self.estimator
        if own.takes_tensors:
            return
        if type(own) is not StateEstimator:
            raise ConfigurationError(
                f"{type(own).__name__} takes arrays of NumPy; on {place} the estimator must take"
                " tensors, as aslip.transforms.device_estimator.DeviceEstimator does"
            )
        from aslip.transforms.device_estimator import DeviceEstimator  # needs Warp

        self.estimator = DeviceEstimator(place, own.robot, own.noise)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory = cast("torch.Tensor", tensordict[unravel_key((self.out_keys[2], "memory"))])
        tracking = Tracking.from_rows(self._taken(memory))
        origin = None
        if self._command_key is not None:
            before = tensordict.get("heading", None)
            past = cast("TensorDictBase", tensordict[self.out_keys[1]])
            command = cast("Tensor", tensordict[self._command_key])
            origin = follow_path(tracking, past, command, before)
        heading = next_tensordict.get("heading", None)
        if heading is not None:
            tracking.heading = self._taken(heading[:, 0])
        estimate = self.estimator.update(tracking, self._taken(self._joined(next_tensordict)))
        mode = None if self._mode_key is None else cast("Tensor", next_tensordict[self._mode_key])
        entries = estimate_entries(tracking, estimate, origin, mode)
        return next_tensordict.update(self._grouped(entries))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL uses only the rows of reset robots, so the others are not started
        rows = reset_rows(tensordict)
        packets = self._joined(tensordict_reset)
        heading = tensordict_reset.get("heading", None)
        if rows is not None:
            packets = packets[rows]
            heading = None if heading is None else heading[rows]
        if heading is not None:
            heading = self._taken(heading)
        origin = torch.zeros(len(packets), 3) if self._path else None
        tracking, estimate = self.estimator.start(self._taken(packets), heading)
        started = self._grouped(estimate_entries(tracking, estimate, origin))
        if rows is None:
            return tensordict_reset.update(started)
        for key, value in started.items(True, True):
            tensordict_reset.set(key, spread(value, rows))
        return tensordict_reset

    def _grouped(self, entries: Mapping[str, Mapping[str, torch.Tensor]]) -> TensorDict:
        """Entries of `estimate_entries` under the keys of this transform."""
        num = len(entries["estimator"]["memory"])
        grouped = TensorDict(batch_size=[num])
        for key, group in zip(self.out_keys, entries.values(), strict=True):
            grouped.set(key, TensorDict(dict(group), batch_size=[num]))
        return grouped

    def _joined(self, tensordict: TensorDictBase) -> Tensor:
        """Packets (n, w, p) of the sensors."""
        return torch.cat([cast("Tensor", tensordict[key]) for key in self.in_keys], dim=-1)

    def _taken(self, value: Tensor) -> Array:
        """Numbers for the estimator, in double precision."""
        return value.double() if self.estimator.takes_tensors else value.double().numpy()

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries of `ESTIMATE_SIZES`, `ODOMETRY_SIZES`, and the estimator's own."""
        spec = super().transform_observation_spec(observation_spec)
        shape, size = tuple(spec.shape), tracking_size()
        spec[self.out_keys[2]] = Composite(
            memory=Unbounded(torch.Size((*shape, size)), dtype=torch.float64),
            faults=Binary(shape=torch.Size((*shape, len(FAULTS))), dtype=torch.bool),
            contact=Binary(shape=torch.Size((*shape, len(SIDES))), dtype=torch.bool),
            shape=spec.shape,
        )
        return spec


def follow_path(
    tracking: Tracking,
    past: Mapping[str, Tensor] | TensorDictBase,
    command: Tensor,
    heading: Tensor | None,
) -> Tensor:
    """Turn the heading of `tracking` with a command, in place; return the origin of its path.

    Args:
        tracking: memory of the estimator before a policy step.
        past: entries of `PATH_SIZES` before the step.
        command: (n, c) command during the step.
        heading: (n, 1) yaw before the step [rad], as a caller may have changed it; by default that
            of `tracking`.

    Returns:
        (n, 3) origin after the step.
    """
    arrays = is_numpy(tracking.heading)
    before = torch.as_tensor(tracking.heading)[:, None] if heading is None else heading
    origin, error = (cast("Tensor", past[name]) for name in PATH_SIZES)
    origin, after = advance_frame(origin, before.float(), command, error)
    turned = after[:, 0].double()
    tracking.heading = turned.numpy() if arrays else turned
    return origin


def estimate_entries(
    tracking: Tracking,
    estimate: Estimate,
    origin: Tensor | None = None,
    mode: Tensor | None = None,
) -> dict[str, dict[str, torch.Tensor]]:
    """Entries of an estimate as tensordicts, one for each group that `EstimatedState` writes.

    Args:
        tracking: memory of the estimator.
        estimate: its estimate.
        origin: (n, 3) origin of the odometry if it moves along a path [m, frame of the IMU's
            attitude]; None for odometry from the start.
        mode: (n, 1) values of `WalkMode`, if the robots have a stand command.
    """
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
        group: {name: _entry(value, torch.float32) for name, value in values.items()}
        for group, values in single.items()
    }
    if origin is not None:
        entries["odometry"] = _along_path(entries["odometry"], tracking, origin, mode)
    entries["estimator"] = {
        "memory": torch.as_tensor(tracking.to_rows()),
        "faults": torch.as_tensor(estimate.faults),
        "contact": _entry(estimate.contact, torch.bool),
    }
    return entries


def _entry(value: Array, dtype: torch.dtype) -> Tensor:
    """Copy of an estimate."""
    return torch.tensor(value, dtype=dtype) if is_numpy(value) else value.to(dtype, copy=True)


def _along_path(
    odometry: Mapping[str, Tensor],
    tracking: Tracking,
    origin: Tensor,
    mode: Tensor | None,
) -> dict[str, Tensor]:
    """Odometry from the start, moved to an origin (n, 3) that the pelvis drags along."""
    heading = torch.as_tensor(tracking.heading)[:, None].float()
    shift = rotate_about_vertical(origin, -heading)
    moved = {
        name: value - shift if name.endswith("_position") else value
        for name, value in odometry.items()
    }
    return place_in_path(moved, origin, heading, mode=mode)
