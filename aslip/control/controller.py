"""Controller that turns packets into motor targets, without simulator or environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from aslip.base.checks import check_number
from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.control.base import ControllerBase, Given
from aslip.control.robot_frame import next_entries, start_entries
from aslip.control.steering import Steering
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.estimation import StateEstimator, Tracking
from aslip.library import GaitLibrary
from aslip.planning import BatchPlanner, Planner
from aslip.policy import entry_names, load_policy, policy_library, read_card
from aslip.transforms.action import add_delta
from aslip.transforms.clock import clock_entries
from aslip.transforms.command import COMMAND_RATES, checked_rates
from aslip.transforms.estimate import estimate_entries, follow_path
from aslip.transforms.observation import OBSERVATION_TABLE, join_entries, planned_table
from aslip.transforms.plan_state import heading_of
from aslip.transforms.planned import PlannedReference, planned_estimator
from aslip.transforms.reference import feedforward_target
from aslip.transforms.rotation import rotate_about_vertical, yaw

# corners (n, m, e, 3) of stones, level in the frame of the estimates [m]
_STONES: Final = ("stones", "place")
# groups of entries that each step overwrites
_FRESH = ("estimate", "odometry", "estimator", "reference", "target", "plan", "clock")
PATH_ERROR = ("odometry", "path_error")
"""Key of the distance from the commanded path, for which robots' own estimates need positions."""


@dataclass(frozen=True)
class ControllerState:
    """Immutable state of a `Controller` between policy steps; each step returns a new one."""

    tensordict: TensorDictBase
    """Inputs and outputs (n,) of the policy, with the keys of an environment's tensordict:
    `command`, `phase`, `estimate`, `reference`, `target`, `clock`, `last_action`, `is_init`,
    `observation`, `action`, `motor_target`, and the hidden state of a recurrent policy. With
    packets, `odometry` and `estimator` (its faults, and its memory with the heading), too; with
    robots' own estimates, `heading` and, where these have positions along a path, `odometry` of
    `origin` and `path_error`. With a library of several axes, `filtered_command`, too; if robots
    take stand commands, `stand` (n, 1) and `mode` (n, 1), values of `aslip.library.WalkMode`."""

    @property
    def motor_target(self) -> Tensor:
        """Target angles (n, m) of the PD loops until the next step [rad]."""
        return cast("Tensor", self.tensordict["motor_target"])

    @property
    def own_estimates(self) -> bool:
        """True for robots that estimate their own state, False for robots that send packets."""
        return "estimator" not in self.tensordict


class Controller(ControllerBase[ControllerState]):
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

    A controller whose policy stands takes a stand command, 1 to stand and 0 to walk: the robots
    slow down, stop at a touchdown, stand, and start again (`StandClock`).

    A robot that estimates its own state sends estimates instead of packets. The controller rotates
    them to the heading and does not filter them. The last one is kept if an estimate is missing,
    not finite, or such as no robot can have (`aslip.robot.robot.LARGEST`).

    Args:
        policy: name of a shipped policy, a policy file, or a module that maps `observation`, or any
            key of `ControllerState.tensordict`, to `action`.
        library: the gaits; by default those that `aslip.policy.policy_library` finds.
        observation: keys of the observation's entries in order; by default those in the policy's
            file, or `OBSERVATION_TABLE`.
        baseline: key of the angles to which the action is added; by default the one in the
            policy's file, or `("reference", "motor_target")`.
        estimator: state estimator; its robot defines packets, gains and the policy period.
            With a planner by default that of `planned_estimator`.
        motor_lead: lead of the motor references over the phase, in policy steps; see
            `ReferenceInjection`. With a planner it is one step.
        command_rates: largest rates of the filtered command with a library of several axes
            [m/s^2, rad/s^2], see `CommandFilter`; by default those in the policy's file, or
            `COMMAND_RATES`.
        stands: True for robots that take stand commands; by default as the policy's file says,
            False for a module.
        planner: planner of the footsteps that the policy follows on stones, see
            `PlannedReference`; policies of the stack `planned` have one by default.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy's action is not a delta that is added to angles; it
            follows other gaits; or `stands` is true, and the library has no stop and start.
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
        planner: BatchPlanner | Planner | None = None,
    ) -> None:
        plans = planner is not None
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
            plans |= card["stack"] == "planned"
            library = policy_library(policy, library)
            policy = cast("TensorDictModuleBase", load_policy(policy))
        self.policy = policy
        self.library = library = library or GaitLibrary.load()
        seen = tuple(observation or OBSERVATION_TABLE)
        self.observation = planned_table(seen) if plans else seen
        self.baseline = ("reference", "motor_target") if baseline is None else baseline
        if estimator is None:
            estimator = planned_estimator() if plans else StateEstimator()
        self.estimator = estimator
        self.motor_lead = motor_lead = check_number(
            "motor_lead", motor_lead, what="in policy steps"
        )
        self.command_rates = checked_rates(
            COMMAND_RATES if command_rates is None else command_rates
        )
        self.robot = robot = self.estimator.robot
        self.command_size, self.stands = library.command_size, bool(stands)
        self.steering = Steering(library, self.command_rates, self.stands, motor_lead)
        self._along_path = self.steering.along_path
        self._planned = PlannedReference(library, planner, stands=self.stands) if plans else None
        self.plans = plans
        self._gains = [
            torch.from_numpy(gain.copy()).float() for gain in (robot.stiffness, robot.damping)
        ]

    @property
    def pose(self) -> np.ndarray:
        """Motor angles (m,) of the reference in standing, or in place at phase 0 [rad]."""
        return self.steering.pose().double().numpy()

    @on_cpu_in_single
    def _start(self, given: Given, phase: np.ndarray) -> ControllerState:
        command, num = self._nearest(given.command), len(given.rows)
        commands = self.steering.begin(command, torch.from_numpy(phase), _tensor(given.stand))
        if given.own_estimates:
            self._check_packets()
            entries = start_entries(given.rows, given.heading, self.robot, self._along_path)
        else:
            origin = torch.zeros(num, 3) if self._along_path else None
            entries = estimate_entries(*self.estimator.start(given.rows, given.heading), origin)
        first = torch.ones(num, 1, dtype=torch.bool)
        present = TensorDict({**commands, "is_init": first, **entries}, batch_size=[num])
        return self.act(_with_stones(present, given.stones))

    @on_cpu_in_single
    def _step(self, state: ControllerState, given: Given) -> ControllerState:
        past, num = state.tensordict, len(state.tensordict)
        command = past["command"] if given.command is None else self._nearest(given.command)
        stand = past.get("stand", None) if given.stand is None else _tensor(given.stand)
        # a recurrent policy reads its memory under "next", as in TorchRL's `step_mdp`
        present = past.exclude("next", *_FRESH).update(past.get("next", {}))
        commands = self.steering.advance(past, command, cast("Tensor | None", stand))
        present.update(
            {
                "last_action": past["action"],
                "is_init": torch.zeros(num, 1, dtype=torch.bool),
                **self._followed(past, given, commands.get("mode")),
                **commands,
            }
        )
        return self.act(_with_stones(present, given.stones), past)

    def _check_packets(self) -> None:
        """Check that no planner needs packets.

        Raises:
            ConfigurationError: one does.
        """
        if self._planned is not None:
            raise ConfigurationError(
                "a planner needs the packets of the sensors, which tell when feet land; robots' own"
                " estimates do not"
            )

    def _followed(self, past: TensorDictBase, given: Given, mode: Tensor | None) -> dict[str, Any]:
        """Entries of robots after their packets, or after their own estimates."""
        heading, command = _tensor(given.heading), past.get("filtered_command", None)
        if given.own_estimates:
            return next_entries(past, given.rows, heading, self.robot, command, mode)
        memory = cast("Tensor", past["estimator", "memory"])
        tracking = Tracking.from_rows(memory.numpy(), self.robot)
        origin = None
        if command is not None:
            before = cast("TensorDictBase", past["odometry"])
            origin = follow_path(tracking, before, command, heading)
        elif heading is not None:
            tracking.heading = heading[:, 0].double().numpy()
        estimate = self.estimator.update(tracking, given.rows)
        return estimate_entries(tracking, estimate, origin, mode)

    def _nearest(self, command: np.ndarray | None) -> Tensor:
        """Command (n, c) moved into the region of the library."""
        return self.library.nearest(cast("Tensor", _tensor(command)))

    @torch.no_grad()
    @on_cpu_in_single
    def act(self, present: TensorDictBase, past: TensorDictBase | None = None) -> ControllerState:
        """Compute motor targets from estimate, command and phase, as `start` and `step` do.

        Args:
            present: entries (n,) of a policy step up to the phase; changed in place.
            past: entries of the step before, which planned footsteps go on from; None to begin.

        Returns:
            State with reference, observation, action and motor targets.

        Raises:
            UnknownNameError: the policy observes an entry that does not exist.
        """
        if self._planned is None:
            reference, target = self.steering.reference(cast("Mapping[str, Tensor]", present))
            present.update({"reference": reference, "target": target})
        elif past is None:
            self._planned.begin(present)
        else:
            self._planned.go_on(past, present)
        reference = cast("Mapping[str, Tensor]", present["reference"])
        present["reference", "motor_target"] = feedforward_target(reference, *self._gains)
        present["clock"] = clock_entries(cast("Tensor", present["phase"]))
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


def _with_stones(present: TensorDict, seen: np.ndarray | None) -> TensorDict:
    """Write new stones (n, m, e, 3), or those before, in the present frame of the odometry."""
    if seen is None and _STONES not in present.keys(True):
        return present
    odometry, heading = cast("TensorDictBase", present["odometry"]), heading_of(present)
    pelvis, origin = (cast("Tensor", odometry[n]) for n in ("pelvis_position", "origin"))
    turn = heading[:, None, None]
    if seen is not None:
        ahead = yaw(cast("Tensor", odometry["pelvis_orientation"]))[:, None, None]
        placed = rotate_about_vertical(torch.from_numpy(seen), ahead) + pelvis[:, None, None]
        present[_STONES] = rotate_about_vertical(placed, turn) + origin[:, None, None]
    placed = rotate_about_vertical(present[_STONES] - origin[:, None, None], -turn)
    present["stones", "corners"] = placed[..., :2]
    present["stones", "height"] = placed[..., 2].mean(-1)
    return present


def _tensor(values: np.ndarray | None) -> Tensor | None:
    """Tensor of an array; None stays None."""
    return None if values is None else torch.from_numpy(values)


def _key(name: str) -> NestedKey:
    """Key of an entry by its name in a policy's card, such as "estimate/height"."""
    return tuple(name.split("/")) if "/" in name else name
