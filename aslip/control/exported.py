"""Controller from an exported policy; needs NumPy and onnxruntime, but no PyTorch or simulator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from aslip.base.assets import user_path
from aslip.control.contract import TOLERANCE, damaged, explained, wrong
from aslip.control.estimates import (
    POSITION,
    check_rows,
    is_estimate,
    join_estimate,
    mark_lost,
    split_estimate,
    start_heading,
)
from aslip.control.exported_file import TYPES, check_order, library_sha256, open_policy, try_steps
from aslip.errors import AssetError, ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot

if TYPE_CHECKING:
    from aslip.estimation import Estimate, StateEstimator, Tracking

Packets = Mapping[str, ArrayLike] | np.ndarray
"""w packets of a robot, oldest first: entries (1, w, k) with the names of `Robot.packet_sizes`, or
all entries concatenated to (1, w, p). One packet has no leading axes.

For a robot that estimates its own state, entries (1, k) or (k,) of `Robot.estimate_sizes` instead:
the latest estimate, in a frame with z up against gravity. Policies that observe their distance from
the commanded path also need `position` (3,) of the pelvis [m]."""


@dataclass(frozen=True)
class ExportedState:
    """Immutable state of an `ExportedController` between policy steps; a step returns a new one."""

    entries: Mapping[str, np.ndarray]
    """Outputs (1, k) of the graph by name, such as `motor_target`, `action`, `observation`, `phase`
    and `estimate`, and `heading` [rad]; `Contract.outputs` describes them. If the policy stands on
    a wish, `stand` (1 to stand, 0 to walk), too."""
    tracking: np.ndarray | None = None
    """(1, t) memory of the estimator, as `aslip.estimation.Tracking.to_rows` gives it; None for a
    robot that estimates its own state."""

    @property
    def motor_target(self) -> np.ndarray:
        """Target angles (1, m) of the PD loops until the next step [rad]."""
        return self.entries["motor_target"]


class ExportedController:
    """Compute motor targets of a robot from its packets or estimates, as `aslip.Controller` does.

    The file has everything from estimates to motor targets in one graph: `export_policy` traces it
    from the functions of `aslip.Controller`. Only the estimator for packets is code of this
    package. `start` and `step` work as in `aslip.Controller`, but for one robot and with arrays.
    Run only files that you trust: whoever makes one decides how the robot moves.

    Args:
        path: file of an exported policy.
        robot: robot to control.
        library: gait library that the policy must have been exported with: name of a shipped one,
            file (reading it needs PyTorch) or `GaitLibrary.sha256`; by default any, because the
            exported policy contains its tables.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is truncated or altered, is no exported policy, points to data in
            another file, has weights that are not finite, loops, or operators that onnxruntime
            does not have, or fails to take two steps.
        ConfigurationError: the policy is for another robot, library or version of the contract; the
            message names the first difference.
    """

    def __init__(
        self, path: str | Path, robot: Robot = CASSIE, *, library: str | Path | None = None
    ) -> None:
        self.path, self.robot = user_path(path), robot
        if not self.path.is_file():
            raise AssetError(
                f"there is no exported policy {str(path)!r}; python -m aslip.control.export makes"
                " one"
            )
        self._session, self.contract = open_policy(self.path, robot)
        with explained(self.path):
            found = self.contract.about["library"]["sha256"]
            self._outputs = [output["name"] for output in self.contract.outputs]
            self._inputs = {
                entry["name"]: (TYPES[entry["dtype"]], tuple(entry["shape"]))
                for entry in self.contract.inputs
            }
            self._feedback = self.contract.feedback
            try_steps(self)
        if library is not None and (wanted := library_sha256(str(library), robot)) != found:
            raise wrong(self.path, f"its library has the SHA-256 {found}, not {wanted}")

    @cached_property
    def estimator(self) -> StateEstimator:
        """Estimator for packets; not loaded for robots that estimate their own state."""
        from aslip.estimation import StateEstimator

        return StateEstimator(self.robot)

    @property
    def command_size(self) -> int:
        """Number c of components of a command."""
        return self._inputs["command"][1][-1]

    @property
    def stands(self) -> bool:
        """True for a policy that stands on a wish."""
        return "stand" in self._inputs

    @property
    def pose(self) -> np.ndarray:
        """Motor angles (m,) of the reference in standing, or in place at phase 0 [rad]."""
        return np.array(self.contract.numbers("default_joint_pos"))

    def start(
        self,
        packets: Packets,
        command: float | ArrayLike = 0.0,
        *,
        stand: ArrayLike = 0.0,
        phase: float | ArrayLike = 0.0,
        heading: ArrayLike | None = None,
    ) -> ExportedState:
        """Start with a robot whose lower foot rests on the ground; compute the first targets.

        Args:
            packets: packets, of which only the last is used, or an estimate.
            command: command, one number or (1, c); a number alone is a forward speed.
            stand: wish, 1 to stand or 0 to walk.
            phase: stride fraction to begin at.
            heading: yaw that counts as straight ahead, in the frame of the IMU's attitude or of the
                estimates [rad]; by default that of the packets or estimates.

        Raises:
            ShapeError, UnknownNameError: an argument has the wrong shape, or an entry is missing.
            ConfigurationError: an argument or an estimate is not finite, the estimate is one that
                no robot can have, the policy cannot stand, or needs a position that it lacks.
        """
        rows, tracking = self._rows(packets), None
        if rows.ndim == 3:
            follower, estimate = self.estimator.start(rows, heading)
            tracking, rows = follower.to_rows(), self._joined(estimate)
            ahead = follower.heading[:, None]
        else:
            ahead = start_heading(rows, heading, self.robot)
        given = {
            "first": np.ones((1, 1), dtype=bool),
            "command": self._command(command),
            "last_phase": _numbers("phase", phase, 1),
            "path_heading": ahead,
            **self._wish(stand),
        }
        if POSITION in self._inputs:
            given["last_origin"] = self._origin(rows, tracking)
        return self._run(given, rows, ahead, tracking)

    def step(
        self,
        state: ExportedState,
        packets: Packets | None,
        command: float | ArrayLike | None = None,
        *,
        stand: ArrayLike | None = None,
        heading: float | ArrayLike | None = None,
        restart: ArrayLike | None = None,
        phase: float | ArrayLike = 0.0,
    ) -> tuple[ExportedState, np.ndarray]:
        """Advance by a policy step.

        Args:
            state: state that `start` or the previous step returned.
            packets: packets since then, oldest first, or the latest estimate; None if all are lost.
            command: new command, one number or (1, c). By default it does not change.
            stand: new wish, 1 to stand or 0 to walk. By default it does not change.
            heading: new yaw that counts as straight ahead [rad]. By default it does not change.
            restart: True for a robot that restarts with these packets.
            phase: stride fraction at which the robot restarts.

        Returns:
            New state, and its motor targets (1, m) [rad].

        Raises:
            ShapeError, UnknownNameError: an argument has the wrong shape, or an entry is missing.
            ConfigurationError: an argument is not finite, the policy cannot stand, or packets come
                after a start with an estimate, or the reverse.
        """
        last = state.entries
        now = last["nearest_command"] if command is None else self._command(command)
        rows = self._lost(state) if packets is None else self._rows(packets)
        if (rows.ndim == 2) == (state.tracking is not None):
            kinds = ("packets", "estimates") if rows.ndim == 3 else ("estimates", "packets")
            raise ConfigurationError(f"got {kinds[0]}, but the robot started with {kinds[1]}")
        wish = last.get("stand", 0.0) if stand is None else stand
        if restart is not None and np.asarray(restart).any():
            begun = self.start(rows, now, stand=wish, phase=phase, heading=heading)
            return begun, begun.motor_target
        before, ahead = self._headings(last, heading)
        tracking = state.tracking
        if tracking is not None:
            tracking, estimate = self._track(tracking, rows, ahead)
            rows = self._joined(estimate)
        else:
            rows = mark_lost(rows, self.robot)
        given = {target: last[source] for source, target in self._feedback.items()}
        given |= {"first": np.zeros((1, 1), dtype=bool), "command": now}
        given |= {"path_heading": before, **self._wish(wish)}
        following = self._run(given, rows, ahead, tracking)
        return following, following.motor_target

    def verify(self) -> float:
        """Run the golden trace, and compare its motor targets with PyTorch's.

        Returns:
            Largest difference of a motor target from PyTorch's [rad].

        Raises:
            FileDamagedError: the trace is damaged, a motor target differs by more than `TOLERANCE`,
                or the observation's entries are not in the order of the contract.
        """
        with explained(self.path, "its golden trace cannot be run: "):
            trace = self.contract.golden_trace()
            targets = np.concatenate([step["motor_target"] for step in self._replayed(trace)])
            if targets.shape != trace["target"].shape:
                raise ValueError(f"targets of shape {trace['target'].shape}, not {targets.shape}")
            difference = float(np.abs(targets - trace["target"]).max())
        if not difference <= TOLERANCE:
            raise damaged(
                self.path,
                f"motor targets differ by {difference:.3g} rad from those of its golden trace,"
                f" more than {TOLERANCE:g} rad",
            )
        return difference

    def outputs(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Run the graph: inputs by name -> outputs by name; missing inputs are zero."""
        feed = {
            name: np.asarray(values[name], kind) if name in values else np.zeros(shape, kind)
            for name, (kind, shape) in self._inputs.items()
        }
        found = cast("list[np.ndarray]", self._session.run(self._outputs, feed))
        return dict(zip(self._outputs, found, strict=True))

    def _replayed(self, trace: Mapping[str, np.ndarray]) -> list[Mapping[str, np.ndarray]]:
        """Outputs of the graph at each step of a golden trace."""
        names = ("estimate", "heading", "command", "reset")
        wishes = trace["stand"] if self.stands else np.zeros(len(trace["reset"]))
        columns = zip(*(trace[name] for name in names), wishes, strict=True)
        entries, state = [], None
        for row, heading, command, start, stand in columns:
            estimate = split_estimate(row[None], self.robot)
            wish: dict[str, Any] = {"stand": stand, "heading": heading[None]}
            if state is None or start:
                state = self.start(estimate, command[None], phase=trace["phase"], **wish)
            else:
                state, _ = self.step(state, estimate, command[None], **wish)
            entries.append(state.entries)
            check_order(state.entries, self.contract.observation, self.robot)
        return entries

    def _run(
        self,
        given: Mapping[str, np.ndarray],
        rows: np.ndarray,
        heading: np.ndarray,
        tracking: np.ndarray | None,
    ) -> ExportedState:
        """Run the graph for an estimate (1, e)."""
        # the estimator for packets has already rotated its estimates to the heading
        turn = heading if tracking is None else np.zeros_like(heading)
        parts = {POSITION: np.full((1, 3), np.nan), **split_estimate(rows, self.robot)}
        entries = self.outputs({**parts, "heading": turn, **given})
        wish = {"stand": given["stand"]} if self.stands else {}
        return ExportedState({**entries, "heading": heading, **wish}, tracking)

    def _headings(
        self, last: Mapping[str, np.ndarray], heading: ArrayLike | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Headings (1, 1) before and after a step along the path of a command [rad]."""
        before = last["heading"]
        if heading is not None:
            # rounded as PyTorch does by default
            before = _numbers("heading", heading, 1).astype(np.float32).astype(np.float64)
        steer = last.get("filtered_command")
        if steer is None or steer.shape[1] < 3:
            return before, before
        ahead = before + np.float32(self.robot.policy_period) * steer[:, 2:3]
        turns = np.round(ahead / math.tau)
        return before, np.where(np.abs(ahead) > math.pi, ahead - math.tau * turns, ahead)

    def _origin(self, rows: np.ndarray, tracking: np.ndarray | None) -> np.ndarray:
        """Origin (1, 3) of the path of a robot that starts [m].

        Raises:
            ConfigurationError: the estimate has no position.
        """
        if tracking is not None:
            return np.zeros((1, 3))
        position = split_estimate(rows, self.robot).get(POSITION)
        if position is None:
            raise ConfigurationError(
                f"the exported policy {str(self.path)!r} observes its distance from the commanded"
                f" path, so estimates need {POSITION!r}, which this one lacks"
            )
        return np.pad(position[:, :2], ((0, 0), (0, 1)))

    def _wish(self, stand: ArrayLike) -> dict[str, np.ndarray]:
        """Input `stand` of the graph, if it has one.

        Raises:
            ConfigurationError: the policy cannot stand, and shall.
        """
        wish = _numbers("stand", np.asarray(stand, dtype=np.float32), 1)
        if self.stands:
            return {"stand": wish}
        if wish > 0.5:
            raise ConfigurationError(
                f"the exported policy {str(self.path)!r} cannot stand: its contract has no input"
                " 'stand'; only policies of the stack 'standing' have it"
            )
        return {}

    def _track(
        self, memory: np.ndarray, rows: np.ndarray, heading: np.ndarray
    ) -> tuple[np.ndarray, Estimate]:
        """Memory (1, t) and estimate of the estimator after packets (1, w, p)."""
        from aslip.estimation import Tracking

        tracking: Tracking = Tracking.from_rows(memory, self.robot)
        tracking.heading = heading[:, 0]
        estimate = self.estimator.update(tracking, rows)
        return tracking.to_rows(), estimate

    def _joined(self, estimate: Estimate) -> np.ndarray:
        """Estimate of the estimator as (1, e)."""
        names = (*self.robot.estimate_sizes, POSITION)
        return join_estimate({name: getattr(estimate, name) for name in names}, self.robot)

    def _rows(self, packets: Packets) -> np.ndarray:
        """Packets (1, w, p) or estimate (1, e) from any accepted form."""
        if isinstance(packets, Mapping):
            if is_estimate(packets):
                rows = join_estimate(packets, self.robot)
            else:
                from aslip.estimation.packets import join

                named = {name: np.asarray(value) for name, value in packets.items()}
                rows = join(named, self.robot)
        else:
            rows = np.asarray(packets, dtype=np.float64)
        rows = check_rows(rows[None, None] if rows.ndim == 1 else rows, self.robot)
        if len(rows) != 1:
            raise ShapeError(f"an exported policy controls one robot, got packets of {len(rows)}")
        return rows

    def _lost(self, state: ExportedState) -> np.ndarray:
        """Array of NaN in place of the packets, or of the estimate."""
        own = sum(self.robot.estimate_sizes.values())
        size = (1, own) if state.tracking is None else (1, 1, self.robot.packet_size)
        return np.full(size, np.nan)

    def _command(self, command: float | ArrayLike) -> np.ndarray:
        """Command (1, c) in single precision; the graph moves it into the region of the library."""
        value, size = np.asarray(command, dtype=np.float32), self.command_size
        if size > 1 and value.ndim == 0:
            value = np.pad(value[None], (0, size - 1))
        return _numbers("command", value, size).astype(np.float32)


def _numbers(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """Numbers (1, size).

    Raises:
        ShapeError: `value` has another shape.
        ConfigurationError: a number is not finite.
    """
    array = np.asarray(value)
    one: Sequence[tuple[int, ...]] = [(), (1,), (1, 1)] if size == 1 else [(size,), (1, size)]
    if array.shape not in one:
        what = "one number" if size == 1 else f"{size} numbers"
        raise ShapeError(f"{name} must be {what} or (1, {size}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ConfigurationError(f"{name} must be finite, got {array.tolist()}")
    return array.reshape(1, size)
