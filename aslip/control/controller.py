"""Controller that turns packets into motor targets, without simulator or environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from aslip.base.checks import check_number
from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.control.estimates import check_rows, is_estimate, join_estimate
from aslip.control.robot_frame import next_entries, start_entries
from aslip.control.steering import Steering
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.estimation import StateEstimator, Tracking
from aslip.estimation.packets import join
from aslip.library import GaitLibrary
from aslip.policy import check_policy_library, entry_names, load_policy, policy_library, read_card
from aslip.transforms.action import add_delta
from aslip.transforms.clock import clock_entries
from aslip.transforms.command import COMMAND_RATES, checked_rates
from aslip.transforms.estimate import estimate_entries, follow_path
from aslip.transforms.observation import OBSERVATION_TABLE, join_entries
from aslip.transforms.reference import feedforward_target

Packets = Mapping[str, ArrayLike] | TensorDictBase | np.ndarray
"""Packets of n robots, w each and oldest first: entries (n, w, k) with the names of
`Robot.packet_sizes`, or all entries concatenated to (n, w, p). One packet of one robot has no
leading axes.

For robots that estimate their own state, entries (n, k) of `Robot.estimate_sizes` instead: the
latest estimates, in frames with z up against gravity. Policies that observe their distance from the
commanded path also need `position` (n, 3) of the pelvis [m]."""


# groups of entries that each step overwrites
_FRESH = ("estimate", "odometry", "estimator", "reference", "goal", "clock")
PATH_ERROR = ("odometry", "path_error")
"""Key of the distance from the commanded path, for which robots' own estimates need positions."""


@dataclass(frozen=True)
class ControllerState:
    """Immutable state of a `Controller` between policy steps; each step returns a new one."""

    tensordict: TensorDictBase
    """Inputs and outputs (n,) of the policy, with the keys of an environment's tensordict:
    `command`, `phase`, `estimate`, `reference`, `goal`, `clock`, `last_action`, `is_init`,
    `observation`, `action`, `motor_target`, and the hidden state of a recurrent policy. With
    packets, `odometry` and `estimator` (its faults, and its memory with the heading), too; with
    robots' own estimates, `heading` and, where these have positions along a path, `odometry` of
    `origin` and `path_error`. With a library of several axes, `filtered_command`, too; if robots
    stand on a wish, `stand` (n, 1) and `mode` (n, 1), values of `aslip.library.WalkMode`."""

    @property
    def motor_target(self) -> Tensor:
        """Target angles (n, m) of the PD loops until the next step [rad]."""
        return cast("Tensor", self.tensordict["motor_target"])


class Controller:
    """Compute motor targets of n robots from their sensor packets, at every policy step.

    Estimator, clock, reference, observation, policy and feedforward are those of the training
    stacks: from the packets of a rollout, the controller computes the motor targets of that rollout
    bit for bit. The control loop of a robot:

        controller = Controller("straight")
        state = controller.start(packets, command=0.5)
        while True:
            drive(state.motor_target)
            state, target = controller.step(state, packets, command=0.5)

    A step takes all packets since the previous step. Fill lost packets with NaN, or pass None if
    all are lost; the estimator detects bad readings and bridges them (`aslip.estimation`). A
    command outside the region of the library is moved to the nearest command inside.

    A command has c numbers, one per axis of the library: forward speed, sideways speed [m/s], yaw
    rate [rad/s]. A number alone is a forward speed. With several axes, reference and clock follow a
    filtered command (`CommandFilter`), and heading and origin of the odometry move along its path
    (`HeadingFrame`), so that a yaw rate turns the robot without a new heading.

    A controller whose policy stands takes a wish, 1 to stand and 0 to walk: the robots slow down,
    stop at a touchdown, stand, and start again (`StandClock`).

    A robot that estimates its own state sends estimates instead of packets. The controller rotates
    them to the heading and does not filter them. The last one is kept if an estimate is missing,
    not finite, or such as no robot can have (`aslip.robot.robot.LARGEST`).

    Args:
        policy: name of a shipped policy, a policy file, or a module that maps `observation`, or any
            key of `ControllerState.tensordict`, to `action`.
        library: the gaits; by default the shipped ones of the policy's stack.
        observation: keys of the observation's entries in order; by default those in the policy's
            file, or `OBSERVATION_TABLE`.
        baseline: key of the angles to which the action is added; by default the one in the
            policy's file, or `("reference", "motor_target")`.
        estimator: state estimator; its robot defines packets, gains and the policy period.
        motor_lead: lead of the motor references over the phase, in policy steps; see
            `ReferenceInjection`.
        command_rates: largest rates of the filtered command with a library of several axes
            [m/s^2, rad/s^2], see `CommandFilter`; by default those in the policy's file, or
            `COMMAND_RATES`.
        stands: True for robots that stand on a wish; by default as the policy's file says, False
            for a module.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy's action is not a delta that is added to angles; it was
            trained on other gaits; or robots shall stand, and the library has no stop and start.
    """

    @check_types
    @on_cpu_in_single
    def __init__(
        self,
        policy: str | Path | TensorDictModuleBase,
        library: GaitLibrary | None = None,
        *,
        observation: Sequence[NestedKey] | None = None,
        baseline: NestedKey | None = None,
        estimator: StateEstimator | None = None,
        motor_lead: float = 1.0,
        command_rates: Sequence[float] | None = None,
        stands: bool | None = None,
    ) -> None:
        if isinstance(policy, str | Path):
            card = read_card(policy)
            observation = observation or [_key(name) for name in card["observation"]]
            if baseline is None and card["baseline"] is None:
                raise ConfigurationError(
                    f"the action of the policy {str(policy)!r} is not a delta that is added to"
                    " angles, so a controller cannot turn it into motor targets; give `baseline`"
                )
            baseline = baseline or _key(card["baseline"])
            command_rates = card["command_rates"] if command_rates is None else command_rates
            stands = card["stands"] if stands is None else stands
            library = library or GaitLibrary.load(policy_library(policy))
            check_policy_library(policy, card, partial(getattr, library, "sha256"))
            policy = cast("TensorDictModuleBase", load_policy(policy))
        self.policy = policy
        self.library = library = library or GaitLibrary.load()
        self.observation = tuple(observation or OBSERVATION_TABLE)
        self.baseline = ("reference", "motor_target") if baseline is None else baseline
        self.estimator = StateEstimator() if estimator is None else estimator
        self.motor_lead = motor_lead = check_number(
            "motor_lead", motor_lead, what="in policy steps"
        )
        self.command_rates = checked_rates(
            COMMAND_RATES if command_rates is None else command_rates
        )
        robot = self.estimator.robot
        self.steering = Steering(library, self.command_rates, bool(stands), motor_lead)
        self._along_path = self.steering.along_path
        self._gains = [
            torch.from_numpy(gain.copy()).float() for gain in (robot.stiffness, robot.damping)
        ]

    @on_cpu_in_single
    def start(
        self,
        packets: Packets,
        command: float | Sequence[float] | Tensor = 0.0,
        *,
        stand: bool | float | Tensor = 0.0,
        phase: float | Tensor = 0.0,
        heading: ArrayLike | None = None,
    ) -> ControllerState:
        """Start with robots whose lower foot rests on the ground; compute the first targets.

        Args:
            packets: packets; only the last of each robot is used.
            command: command, one for all robots or (n, c).
            stand: wish, 1 to stand or 0 to walk, one or (n, 1).
            phase: stride fraction to begin at, one or (n, 1).
            heading: yaw that counts as straight ahead, in the frame of the IMU's attitude [rad],
                one or (n, 1); by default the yaw in the packets.

        Raises:
            ShapeError, UnknownNameError: packets, command, phase or heading have the wrong shape,
                or the packets lack an entry.
            ConfigurationError: command, wish, phase or heading is not finite, an estimate is not
                finite or impossible, or these robots cannot stand.
        """
        rows = self._rows(packets)
        num = len(rows)
        wish, begins = self._wish(stand, num), _column("phase", phase, num)
        entries = self.steering.begin(self._command(command, num), begins, wish)
        return self.act(self._begin(rows, entries, heading))

    @on_cpu_in_single
    def step(
        self,
        state: ControllerState,
        packets: Packets | None,
        command: float | Sequence[float] | Tensor | None = None,
        *,
        stand: bool | float | Tensor | None = None,
        heading: float | Tensor | None = None,
        restart: Tensor | None = None,
        phase: float | Tensor = 0.0,
    ) -> tuple[ControllerState, Tensor]:
        """Advance by a policy step.

        Args:
            state: state that `start` or the previous step returned.
            packets: packets since then, oldest first; None if all are lost.
            command: new command, one for all robots or (n, c). It acts from the previous policy
                step on, as when a caller writes `command` between the steps of an environment. By
                default the command does not change.
            stand: new wish, 1 to stand or 0 to walk, one or (n, 1), which acts like a new command.
            heading: new yaw that counts as straight ahead [rad], one or (n, 1).
            restart: (n, 1) bool, robots that restart with these packets, as after a reset of an
                environment.
            phase: stride fraction at which robots restart, one or (n, 1).

        Returns:
            New state, and its motor targets (n, m) [rad].

        Raises:
            ShapeError, UnknownNameError: an argument has the wrong shape, or the packets lack an
                entry.
            ConfigurationError: an argument is not finite, or these robots cannot stand.
        """
        past, num = state.tensordict, len(state.tensordict)
        rows = self._lost(past) if packets is None else self._rows(packets, num)
        now = past["command"] if command is None else self._command(command, num)
        wish = past.get("stand", None) if stand is None else self._wish(stand, num)
        ahead = None if heading is None else _column("heading", heading, num)
        # a recurrent policy reads its memory under "next", as in TorchRL's `step_mdp`
        present = past.exclude("next", *_FRESH).update(past.get("next", {}))
        steered = self.steering.advance(past, now, cast("Tensor | None", wish))
        present.update(
            {
                "last_action": past["action"],
                "is_init": torch.zeros(num, 1, dtype=torch.bool),
                **self._followed(past, rows, ahead, steered.get("mode")),
                **steered,
            }
        )
        if restart is not None and restart.any():
            present = self._restarted(present, restart.reshape(num), rows, phase, ahead)
        state = self.act(present)
        return state, state.motor_target

    def _begin(
        self, rows: np.ndarray, steered: Mapping[str, Tensor], heading: ArrayLike | None
    ) -> TensorDict:
        """Entries of robots that start with packets (n, w, p), or with estimates (n, e)."""
        if rows.ndim == 3:
            origin = torch.zeros(len(rows), 3) if self._along_path else None
            begun = self.estimator.start(rows, heading)
            entries = estimate_entries(*begun, origin)
        else:
            entries = start_entries(rows, heading, self.estimator.robot, self._along_path)
        first = torch.ones(len(rows), 1, dtype=torch.bool)
        return TensorDict({**steered, "is_init": first, **entries}, batch_size=[len(rows)])

    def _restarted(
        self,
        present: TensorDictBase,
        robots: Tensor,
        rows: np.ndarray,
        phase: float | Tensor,
        heading: Tensor | None,
    ) -> TensorDictBase:
        """Entries (n,) after the robots of a mask (n,) restart with these packets or estimates."""
        present = present.clone()
        ahead = None if heading is None else heading[robots].double().numpy()
        phases = _column("phase", phase, len(present))
        command, stand = (cast("Tensor", present.get(k, phases)) for k in ("command", "stand"))
        wish = stand[robots] if self.steering.stands else None
        entries = self.steering.begin(command[robots], phases[robots], wish)
        begun = self._begin(rows[robots.numpy()], entries, ahead)
        # entries that only the other robots have are zero
        zeros = present[: len(begun)].clone().zero_()
        present[robots] = zeros.update(begun)
        return present

    def _followed(
        self, past: TensorDictBase, rows: np.ndarray, heading: Tensor | None, mode: Tensor | None
    ) -> dict[str, Any]:
        """Entries of robots after packets (n, w, p), or after their own estimates (n, e)."""
        if (rows.ndim == 2) == ("estimator" in past):
            kinds = ("packets", "estimates")
            got, started = kinds if rows.ndim == 3 else kinds[::-1]
            raise ConfigurationError(f"got {got}, but the robots started with {started}")
        command = cast("Tensor | None", past.get("filtered_command", None))
        if rows.ndim == 2:
            return next_entries(past, rows, heading, self.estimator.robot, command, mode)
        memory = cast("Tensor", past["estimator", "memory"])
        tracking = Tracking.from_rows(memory.numpy(), self.estimator.robot)
        origin = None
        if command is not None:
            before = cast("TensorDictBase", past["odometry"])
            origin = follow_path(tracking, before, command, heading)
        elif heading is not None:
            tracking.heading = heading[:, 0].double().numpy()
        estimate = self.estimator.update(tracking, rows)
        return estimate_entries(tracking, estimate, origin, mode)

    @torch.no_grad()
    @on_cpu_in_single
    def act(self, present: TensorDictBase) -> ControllerState:
        """Compute motor targets from estimate, command and phase, as `start` and `step` do.

        Args:
            present: entries (n,) of a policy step up to the phase; changed in place.

        Returns:
            State with reference, observation, action and motor targets.

        Raises:
            UnknownNameError: the policy observes an entry that does not exist.
        """
        reference, goal = self.steering.reference(cast("Mapping[str, Tensor]", present))
        reference["motor_target"] = feedforward_target(reference, *self._gains)
        clock = clock_entries(cast("Tensor", present["phase"]))
        present.update({"reference": reference, "goal": goal, "clock": clock})
        if "last_action" not in present:
            present["last_action"] = torch.zeros_like(reference["motor_position"])
        for key in (*self.observation, self.baseline):
            if present.get(key, None) is None:
                known = sorted(entry_names(present.keys(True, True)))
                lacks = "; estimates lack 'position'" if key == PATH_ERROR else ""
                raise UnknownNameError(
                    f"a controller cannot observe {key!r}{lacks}; there are {known}"
                )
        present["observation"] = join_entries(present, self.observation)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            present = self.policy(present)
        baseline, action = (cast("Tensor", present[key]) for key in (self.baseline, "action"))
        return ControllerState(present.set("motor_target", add_delta(baseline, action)))

    def _rows(self, packets: Packets, num: int | None = None) -> np.ndarray:
        """Packets (n, w, p) or estimates (n, e) from any accepted form, of `num` robots."""
        robot = self.estimator.robot
        if isinstance(packets, TensorDictBase | Mapping):
            named = {str(name): np.asarray(value) for name, value in packets.items()}
            if is_estimate(named):
                return check_rows(join_estimate(named, robot), robot, num)
            packets = join(named, robot)
        rows = np.asarray(packets, dtype=np.float64)
        return check_rows(rows[None, None] if rows.ndim == 1 else rows, robot, num)

    def _lost(self, past: TensorDictBase) -> np.ndarray:
        """Array of NaN in place of the packets, or of the estimates, of all robots."""
        robot = self.estimator.robot
        own = sum(robot.estimate_sizes.values())
        size = (1, robot.packet_size) if "estimator" in past else (own,)
        return np.full((len(past), *size), np.nan)

    def _command(self, command: float | Sequence[float] | Tensor, num: int) -> Tensor:
        """Command (num, c) in the region of the library."""
        size = self.library.command_size
        value = torch.as_tensor(command, dtype=torch.float32)
        if size > 1 and value.ndim == 0:
            value = torch.nn.functional.pad(value[None], (0, size - 1))
        return self.library.nearest(_columns("command", value, num, size))

    def _wish(self, stand: float | Tensor, num: int) -> Tensor | None:
        """Wish (num, 1) to stand; None for robots that only walk.

        Raises:
            ConfigurationError: a robot that cannot stand shall.
        """
        wish = _column("stand", stand, num)
        if self.steering.stands:
            return wish
        if (wish > 0.5).any():
            raise ConfigurationError(
                "these robots cannot stand: their policy was not trained for it; give"
                " Controller(..., stands=True) if it was, and a library with stop and start"
            )
        return None


def _column(name: str, value: float | Tensor, num: int) -> Tensor:
    """Column (num, 1) from one number for all robots or one per robot; see `_columns`."""
    return _columns(name, torch.as_tensor(value, dtype=torch.float32), num, 1)


def _columns(name: str, value: Tensor, num: int, size: int) -> Tensor:
    """Values (num, size), from one for all robots or one per robot.

    Raises:
        ShapeError: `value` has another shape.
        ConfigurationError: a number is not finite.
    """
    one = () if size == 1 else (size,)
    if value.shape not in (one, (num, size)):
        what = "one number" if size == 1 else f"{size} numbers"
        raise ShapeError(f"{name} must be {what} or ({num}, {size}), got {tuple(value.shape)}")
    if not value.isfinite().all():
        raise ConfigurationError(f"{name} must be finite, got {value.tolist()}")
    return value.expand(num, size).clone()


def _key(name: str) -> NestedKey:
    """Key of an entry by its name in a policy's card, such as "estimate/height"."""
    return tuple(name.split("/")) if "/" in name else name
