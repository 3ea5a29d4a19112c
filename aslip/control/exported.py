"""Controller from an exported policy; needs NumPy and onnxruntime, but no PyTorch or simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from aslip.base.assets import user_path
from aslip.control.base import ControllerBase, Given
from aslip.control.contract import TOLERANCE, damaged, explained
from aslip.control.estimates import (
    POSITION,
    check_first,
    join_estimate,
    mark_lost,
    split_estimate,
)
from aslip.control.exported_file import TYPES, open_policy, try_steps
from aslip.errors import AssetError, ConfigurationError
from aslip.robot import CASSIE, Robot
from aslip.robot.rotation import yaw

if TYPE_CHECKING:
    from aslip.estimation import Estimate, StateEstimator


@dataclass(frozen=True)
class ExportedState:
    """Immutable state of an `ExportedController` between policy steps; a step returns a new one."""

    entries: Mapping[str, np.ndarray]
    """Outputs (1, k) of the graph by name, such as `motor_target`, `action`, `observation`,
    `phase`, `estimate` and `heading`; `Contract.outputs` describes them. If the policy takes stand
    commands, `stand` (1 to stand, 0 to walk), too."""
    tracking: np.ndarray | None = None
    """(1, t) memory of the estimator, as `aslip.estimation.Tracking.to_rows` gives it; None for a
    robot that estimates its own state."""

    @property
    def motor_target(self) -> np.ndarray:
        """Target angles (1, m) of the PD loops until the next step [rad]."""
        return self.entries["motor_target"]

    @property
    def own_estimates(self) -> bool:
        """True for a robot that estimates its own state, False for one that sends packets."""
        return self.tracking is None


class ExportedController(ControllerBase[ExportedState]):
    """Compute motor targets of a robot from its packets or estimates, as `aslip.Controller` does.

    The file has everything from estimates to motor targets in one graph: `export_policy` traces it
    from the functions of `aslip.Controller`. Only the estimator for packets is code of this
    package. `start` and `step` are those of `aslip.Controller`, for one robot and with arrays.
    Run only files that you trust: whoever makes one decides how the robot moves.

    Args:
        path: file of an exported policy.
        robot: robot to control.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is truncated or altered, is no exported policy, points to data in
            another file, has weights that are not finite, loops, or operators that onnxruntime
            does not have, or fails to take two steps.
        ConfigurationError: the policy is for another robot or version of the contract; the message
            names the first difference.
    """

    num_robots = 1

    def __init__(self, path: str | Path, robot: Robot = CASSIE) -> None:
        self.path, self.robot = user_path(path), robot
        if not self.path.is_file():
            raise AssetError(
                f"there is no exported policy {str(self.path)!r}; python -m aslip.control.export"
                " makes one"
            )
        self._session, self.contract = open_policy(self.path, robot)
        with explained(self.path):
            self._outputs = [output["name"] for output in self.contract.outputs]
            self._inputs = {
                entry["name"]: (TYPES[entry["dtype"]], tuple(entry["shape"]))
                for entry in self.contract.inputs
            }
            self._feedback = self.contract.feedback
            self.command_size = self._inputs["command"][1][-1]
            self.stands = "stand" in self._inputs
            try_steps(self)

    @cached_property
    def estimator(self) -> StateEstimator:
        """Estimator for packets; not loaded for robots that estimate their own state."""
        from aslip.estimation import StateEstimator

        return StateEstimator(self.robot)

    @property
    def pose(self) -> np.ndarray:
        """Motor angles (m,) of the reference in standing, or in place at phase 0 [rad]."""
        return np.array(self.contract.numbers("default_joint_pos"))

    def _start(self, given: Given, phase: np.ndarray) -> ExportedState:
        rows, tracking = given.rows, None
        if not given.own_estimates:
            # heading zero: the frame of the IMU's attitude
            follower, estimate = self.estimator.start(rows, heading=0.0)
            rows, tracking = self._joined(estimate), follower.to_rows()
        check_first(rows, self.robot)
        parts = split_estimate(rows, self.robot)
        heading = yaw(parts["orientation"])[:, None] if given.heading is None else given.heading
        inputs: dict[str, Any] = {"first": [[True]], "last_phase": phase, "last_heading": heading}
        if POSITION in self._inputs:
            inputs["last_origin"] = self._origin(parts)
        return self._run(inputs | self._commands(given), parts, tracking)

    def _step(self, state: ExportedState, given: Given) -> ExportedState:
        last, rows, tracking = state.entries, given.rows, state.tracking
        if tracking is None:
            rows = mark_lost(rows, self.robot)
        else:
            from aslip.estimation import Tracking

            follower = Tracking.from_rows(tracking, self.robot)
            rows = self._joined(self.estimator.update(follower, rows))
            tracking = follower.to_rows()
        inputs = {target: last[source] for source, target in self._feedback.items()}
        inputs |= {"command": last["nearest_command"]}
        inputs |= {"stand": last["stand"]} if self.stands else {}
        if given.heading is not None:
            inputs["last_heading"] = given.heading
        parts = split_estimate(rows, self.robot)
        return self._run(inputs | self._commands(given), parts, tracking)

    def verify(self, trace: Mapping[str, np.ndarray] | None = None) -> float:
        """Run a trace, and compare its motor targets with PyTorch's.

        Args:
            trace: arrays of `aslip.control.export.golden.golden_trace`; by default those in the
                file.

        Returns:
            Largest difference of a motor target from PyTorch's [rad].

        Raises:
            FileDamagedError: the trace is damaged, or a motor target differs by more than
                `TOLERANCE`.
        """
        with explained(self.path, "its golden trace cannot be run: "):
            trace = self.contract.golden_trace() if trace is None else trace
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
        results = cast("list[np.ndarray]", self._session.run(self._outputs, feed))
        return dict(zip(self._outputs, results, strict=True))

    def _replayed(self, trace: Mapping[str, np.ndarray]) -> list[Mapping[str, np.ndarray]]:
        """Outputs of the graph at each step of a golden trace."""
        names = ("estimate", "heading", "command", "reset")
        stands = trace["stand"] if self.stands else np.zeros(len(trace["reset"]))
        columns = zip(*(trace[name] for name in names), stands, strict=True)
        entries, state = [], None
        for row, heading, command, start, stand in columns:
            estimate = split_estimate(row[None], self.robot)
            given: dict[str, Any] = {"stand": stand, "heading": heading[None]}
            if state is None or start:
                state = self.start(estimate, command[None], phase=trace["phase"], **given)
            else:
                state, _ = self.step(state, estimate, command[None], **given)
            entries.append(state.entries)
        return entries

    def _run(
        self,
        inputs: Mapping[str, np.ndarray],
        parts: Mapping[str, np.ndarray],
        tracking: np.ndarray | None,
    ) -> ExportedState:
        """Run the graph for an estimate, entries (1, k)."""
        entries = self.outputs({POSITION: np.full((1, 3), np.nan), **parts, **inputs})
        stand = {"stand": inputs["stand"]} if self.stands else {}
        return ExportedState({**entries, **stand}, tracking)

    @staticmethod
    def _commands(given: Given) -> dict[str, np.ndarray]:
        """Inputs of the graph for new commands."""
        commands = {"command": given.command, "stand": given.stand}
        return {name: value for name, value in commands.items() if value is not None}

    def _origin(self, parts: Mapping[str, np.ndarray]) -> np.ndarray:
        """Origin (1, 3) of the path of a robot that starts [m].

        Raises:
            ConfigurationError: the estimate has no position.
        """
        if POSITION not in parts:
            raise ConfigurationError(
                f"the exported policy {str(self.path)!r} observes its distance from the commanded"
                f" path, so estimates need {POSITION!r}, which this one lacks"
            )
        return np.pad(parts[POSITION][:, :2], ((0, 0), (0, 1)))

    def _joined(self, estimate: Estimate) -> np.ndarray:
        """Estimate of the estimator as (1, e)."""
        names = (*self.robot.estimate_sizes, POSITION)
        return join_estimate({name: getattr(estimate, name) for name in names}, self.robot)
