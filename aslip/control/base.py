"""Arguments that all controllers take, as arrays of n robots; needs no PyTorch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from aslip.control.estimates import join_estimate
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import Robot

Packets = Mapping[str, ArrayLike] | np.ndarray
"""Packets of n robots, w each and oldest first: entries (n, w, k) with the names of
`Robot.packet_sizes`, or all entries concatenated to (n, w, p). One packet of one robot has no
leading axes.

For robots that estimate their own state, entries (n, k) of `Robot.estimate_sizes` instead: the
latest estimates, in frames with z up against gravity. Policies that observe their distance from the
commanded path also need `position` (n, 3) of the pelvis [m]."""


class State(Protocol):
    """State of a controller between policy steps."""

    @property
    def motor_target(self) -> Any:
        """Target angles (n, m) of the PD loops until the next step [rad]."""
        ...

    @property
    def own_estimates(self) -> bool:
        """True for robots that estimate their own state, False for robots that send packets."""
        ...


AnyState = TypeVar("AnyState", bound=State)


class Given(NamedTuple):
    """Checked arguments of a policy step."""

    rows: np.ndarray
    """Packets (n, w, p), or joined estimates (n, e); NaN if lost."""
    own_estimates: bool
    """True if the rows are estimates."""
    command: np.ndarray | None
    """(n, c) command in single precision; None for the last one."""
    stand: np.ndarray | None
    """(n, 1) stand command; None for the last one, and for robots that cannot stand."""
    heading: np.ndarray | None
    """(n, 1) new heading [rad]; None for the present one."""
    stones: np.ndarray | None
    """(n, m, e, 3) corners of stones from the pelvis [m]; None for those of last time."""


class ControllerBase(ABC, Generic[AnyState]):
    """Start and step of a controller, with checks of their arguments."""

    num_robots: int | None = None
    """Number of robots that the controller is for; None for any."""
    robot: Robot
    """Robot that is controlled."""
    command_size: int
    """Number c of components of a command."""
    stands: bool
    """True if the robots take stand commands."""
    plans: bool = False
    """True if a planner decides where and when feet land on stones; it needs packets, not
    estimates."""

    @property
    @abstractmethod
    def pose(self) -> np.ndarray:
        """Motor angles (m,) of the reference in standing, or in place at phase 0 [rad]."""

    @abstractmethod
    def _start(self, given: Given, phase: np.ndarray) -> AnyState:
        """Start with checked arguments, at phases (n, 1)."""

    @abstractmethod
    def _step(self, state: AnyState, given: Given) -> AnyState:
        """Advance by a policy step with checked arguments."""

    def start(
        self,
        packets: Packets,
        command: ArrayLike = 0.0,
        *,
        stand: ArrayLike = 0.0,
        phase: ArrayLike = 0.0,
        heading: ArrayLike | None = None,
        stones: ArrayLike | None = None,
    ) -> AnyState:
        """Start with robots whose lower foot rests on the ground; compute the first targets.

        Args:
            packets: packets, of which only the last of each robot is used, or estimates.
            command: command, one for all robots or (n, c); a number alone is a forward speed.
            stand: stand command, 1 to stand or 0 to walk, one or (n, 1).
            phase: stride fraction at the start, one or (n, 1).
            heading: yaw that counts as straight ahead, in the frame of the IMU's attitude or of the
                estimates [rad], one or (n, 1); by default the yaw in packets or estimates.
            stones: (n, m, e, 3) corners of the stones on which feet may land, from the pelvis and
                along its yaw, level, and NaN where is none [m]. For controllers with a planner;
                without stones robots follow the library.

        Raises:
            ShapeError, UnknownNameError: an argument has the wrong shape, or an entry is missing.
            ConfigurationError: an argument or an estimate is not finite, the estimate is one that
                no robot can have, or these robots cannot stand, or step on stones.
        """
        rows, own = self._rows(packets, self.num_robots)
        num = len(rows)
        given = Given(
            rows,
            own,
            self._command(command, num),
            self._stand(stand, num),
            None if heading is None else columns("heading", heading, num).astype(np.float64),
            self._stones(stones, num),
        )
        return self._start(given, columns("phase", phase, num).astype(np.float32))

    def step(
        self,
        state: AnyState,
        packets: Packets | None,
        command: ArrayLike | None = None,
        *,
        stand: ArrayLike | None = None,
        heading: ArrayLike | None = None,
        stones: ArrayLike | None = None,
    ) -> tuple[AnyState, Any]:
        """Advance by a policy step.

        Args:
            state: state that `start` or the previous step returned.
            packets: packets since then, oldest first, or the latest estimates; None if all are
                lost.
            command: new command, one for all robots or (n, c). It acts from the previous policy
                step on, as when a caller writes `command` between the steps of an environment. By
                default the command does not change.
            stand: new stand command, one or (n, 1), which acts like a new command.
            heading: new yaw that counts as straight ahead [rad], one or (n, 1).
            stones: new stones, see `start`; by default the last ones stay where they are.

        Returns:
            New state, and its motor targets (n, m) [rad].

        Raises:
            ShapeError, UnknownNameError: an argument has the wrong shape, or an entry is missing.
            ConfigurationError: an argument is not finite, these robots cannot stand, or step on
                stones, or packets come after a start with estimates, or the reverse.
        """
        own, num = state.own_estimates, len(state.motor_target)
        rows, got = (self._lost(own, num), own) if packets is None else self._rows(packets, num)
        if got != own:
            kinds = ("packets", "estimates")
            raise ConfigurationError(f"got {kinds[got]}, but the robots started with {kinds[own]}")
        given = Given(
            rows,
            own,
            None if command is None else self._command(command, num),
            None if stand is None else self._stand(stand, num),
            None if heading is None else columns("heading", heading, num).astype(np.float32),
            self._stones(stones, num),
        )
        state = self._step(state, given)
        return state, state.motor_target

    def _stones(self, stones: ArrayLike | None, num: int) -> np.ndarray | None:
        """Stones (num, m, e, 3) in single precision.

        Raises:
            ConfigurationError: there is no planner to step on them.
            ShapeError: they have another shape.
        """
        if stones is None:
            return None
        if not self.plans:
            raise ConfigurationError("stones need a policy that steps where a planner says")
        value = np.asarray(stones, dtype=np.float32)
        if value.ndim != 4 or len(value) != num or value.shape[2] < 3 or value.shape[3] != 3:
            raise ShapeError(f"stones must be ({num}, m, 3 or more, 3), got {value.shape}")
        return value

    def _rows(self, packets: Packets, num: int | None) -> tuple[np.ndarray, bool]:
        """Packets (n, w, p) and False, or joined estimates (n, e) and True, of `num` robots."""
        own = False
        if hasattr(packets, "items"):
            named = {str(name): np.asarray(value) for name, value in packets.items()}
            own = "height" in named
            rows = join_estimate(named, self.robot) if own else _join(named, self.robot)
        else:
            rows = np.asarray(packets, dtype=np.float64)
        rows = rows[None, None] if rows.ndim == 1 else rows
        # the estimator checks the width of packets
        if not own and rows.ndim != 3:
            size = self.robot.packet_size
            raise ShapeError(
                f"packets must have shape (n, w, {size}), or ({size},) of one robot, got"
                f" {rows.shape}"
            )
        if num is not None and len(rows) != num:
            raise ShapeError(f"packets or estimates must come from {num} robots, got {len(rows)}")
        return rows, own

    def _lost(self, own_estimates: bool, num: int) -> np.ndarray:
        """Array of NaN in place of packets, or of estimates."""
        own = sum(self.robot.estimate_sizes.values())
        size = (own,) if own_estimates else (1, self.robot.packet_size)
        return np.full((num, *size), np.nan)

    def _command(self, command: ArrayLike, num: int) -> np.ndarray:
        """Command (num, c) in single precision."""
        value, size = np.asarray(command, dtype=np.float32), self.command_size
        if size > 1 and value.ndim == 0:
            value = np.pad(value[None], (0, size - 1))
        return columns("command", value, num, size)

    def _stand(self, stand: ArrayLike, num: int) -> np.ndarray | None:
        """Stand command (num, 1) in single precision; None for robots that cannot stand.

        Raises:
            ConfigurationError: a robot that cannot stand gets the command to stand.
        """
        value = columns("stand", np.asarray(stand, dtype=np.float32), num)
        if self.stands:
            return value
        if (value > 0.5).any():
            raise ConfigurationError(
                "these robots cannot stand: their policy was not trained for it; if it was, give"
                " Controller(..., stands=True), and a library with stop and start"
            )
        return None


def _join(named: Mapping[str, np.ndarray], robot: Robot) -> np.ndarray:
    """Join the entries of packets."""
    # imported late: compiled by Numba, and not needed for robots with estimates of their own
    from aslip.estimation.packets import join

    return join(named, robot)


def columns(name: str, value: ArrayLike, num: int, size: int = 1) -> np.ndarray:
    """Values (num, size), from one for all robots or one per robot.

    Raises:
        ShapeError: `value` has another shape.
        ConfigurationError: a number is not finite.
    """
    array = np.asarray(value)
    if array.shape not in ((size,), (num, size)) and (array.ndim or size > 1):
        what = "one number" if size == 1 else f"{size} numbers"
        raise ShapeError(f"{name} must be {what} or ({num}, {size}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ConfigurationError(f"{name} must be finite, got {array.tolist()}")
    return np.broadcast_to(array, (num, size)).copy()
