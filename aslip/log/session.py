"""Topics of a log and the times at which they are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

import mujoco
import numpy as np
from tensordict import TensorDictBase

from aslip.envs import SimulatedEnv
from aslip.errors import ConfigurationError
from aslip.library.footholds import Footholds
from aslip.log import messages
from aslip.log.bodies import LoggedKinematics, robot_description
from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES
from aslip.log.template import (
    FlatTopic,
    Template,
    joints_template,
    state_template,
    transforms_template,
)
from aslip.log.writer import LogWriter
from aslip.robot import CASSIE, SIDES
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost
from aslip.sim.course import STONE
from aslip.transforms.plan_state import followed, footholds_in_world, landing_foot
from aslip.walking.metrics.contact import CONTACT_FORCE

_SUBSTEP_NS = round(CASSIE.physics_timestep * 1e9)
_STEP_NS = CASSIE.substeps * _SUBSTEP_NS
# a chunk ends, and a state for replays is written, once per simulated second
_STEPS_PER_SECOND = round(1 / CASSIE.policy_period)
# policy steps in the air after which a contact is a touchdown
_AIRBORNE_STEPS = 4

_TRUTH = (
    "pelvis_position",
    "pelvis_orientation",
    "pelvis_velocity",
    "pelvis_angular_velocity",
    "pelvis_acceleration",
    *(f"{side}_foot_{name}" for side in SIDES for name in ("position", "velocity", "orientation")),
    "motor_torque",
)

_TRUTH_READ = {*_TRUTH, "qpos", "qvel", "ground_force", "diverged"}
# groups of the tensordict that are topics of named numbers
_GROUPS = ("truth", "estimate", "odometry", "true_odometry", "reference", "plan")
# `filtered_command` in stacks for all directions only, stand command and mode in those that stand
_CLOCK = ("phase", "command", "filtered_command", "stand", "mode")
# inputs of a step
_CAUSES = (*_CLOCK, "action", "motor_target", "push")
_EVENTS = {
    "/robot_description": messages.STRING,
    "/log": messages.LOG,
    "/touchdown": messages.TOUCHDOWN,
}
_OUTCOMES = ("reward", "terminated", "truncated", "done")
_NEVER = np.zeros(1)
_NO_PUSH = np.zeros(3)
_START = {"faults": "fault"}
_INTEGRATION = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_SPRINGS = ("spring_stiffness", "joint_damping")
# not logged: internals of the filter, and functions of phase and command
_UNLOGGED = {
    "estimate": {"memory"},
    "reference": {"motor_velocity", "motor_torque"},
    "plan": {"state"},
}

Row = dict[str, np.ndarray]
"""Entries of one robot in a part of the tensordict."""


def _row(part: TensorDictBase, robot: int) -> Row:
    return {key: value.detach().numpy()[robot] for key, value in part.items()}


class _Entries:
    """Topic of the entries of a robot in a fixed order.

    Args:
        writer: writer of the log.
        topic: topic.
        sample: row that shows the sizes of the entries.
        dtype: type of the numbers.
        entries: keys of the entries -> prefix of the names of their numbers; by default all, with
            their keys.
        names: names of all numbers; from the entries by default.
        length: length of arrays, if entries (length, k) are k named arrays; 0 for numbers.
    """

    def __init__(
        self,
        writer: LogWriter,
        topic: str,
        sample: Row,
        dtype: type[np.floating],
        entries: Mapping[str, str] | None = None,
        *,
        names: Sequence[str] | None = None,
        length: int = 0,
    ) -> None:
        entries = {key: key for key in sample} if entries is None else entries
        names = names or [
            name
            for key, start in entries.items()
            for name in messages.component_names(start, sample[key].size // max(length, 1))
        ]
        self._keys = list(entries)
        # an array has the values of one number over the rows
        self._order: Literal["C", "F"] = "F" if length else "C"
        self._topic = FlatTopic(writer, topic, names, dtype, length)

    def write(self, time_ns: int, row: Row) -> None:
        """Write the message of a row."""
        values = np.concatenate([row[key].ravel(self._order) for key in self._keys])
        self._topic.write(time_ns, values)


class Session:
    """Writer of the log of one robot, from its first reset on."""

    def __init__(
        self,
        writer: LogWriter,
        base: SimulatedEnv,
        robot: int,
        fast: bool,
        footholds: Footholds | None,
        sample: TensorDictBase,
        observed: Sequence[str] | None = None,
    ) -> None:
        self._writer, self._base, self._robot, self._fast = writer, base, robot, fast
        self._footholds = footholds
        self._ticks = -1  # policy steps and resets
        self._episode, self._episode_step = -1, 0
        self._airborne = [0, 0]
        self._state_due = False
        self._kinematics = LoggedKinematics(base.model)
        self._events = {
            topic: (kind, writer.open_channel(topic, kind)) for topic, kind in _EVENTS.items()
        }
        frames = [*self._kinematics.bodies, *ROM_FRAMES]
        self._poses = np.zeros((len(frames), 7))
        self._poses[:, 6] = 1.0
        self._transforms = transforms_template(frames)
        self._joints = joints_template(LOGGED_JOINTS)
        self._fixed = {
            template: writer.open_channel(topic, template.kind)
            for topic, template in (("/tf", self._transforms), ("/joint_states", self._joints))
        }
        self._state_channel = writer.open_channel("/state", messages.STATE)
        self._state: Template | None = None
        self._dynamics: Row = {}
        self._groups = [name for name in _GROUPS if name in sample]
        rows = self._rows(sample)
        single = np.float32
        self._flat = {
            name: _Entries(writer, f"/{name}", rows[name], single, _entries(name, rows[name]))
            for name in self._groups
        }
        if row := rows.get("sensors"):
            length = len(next(iter(row.values())))
            self._flat["sensors"] = _Entries(writer, "/sensors", row, single, length=length)
        if row := rows.get("observation"):
            self._flat["observation"] = _Entries(
                writer, "/observation", row, single, names=observed
            )
        self._stones = base.stones[robot]
        self._most, self._stones_topic = len(self._stones), None
        if self._most:
            self._stones_topic = FlatTopic(writer, "/stones", STONE, length=self._most)
        self._dynamics_topic = _Entries(writer, "/dynamics", self._dynamics_row(), np.float64)
        self._step_topic: _Entries | None = None

    # --------------------------------------------------------------- events

    def reset(self, td: TensorDictBase) -> None:
        """Write the first instant of an episode."""
        self._ticks += 1
        self._episode, self._episode_step = self._episode + 1, 0
        self._airborne = [0, 0]
        rows = self._rows(td)
        self._place(rows)
        if self._ticks == 0:
            urdf = robot_description(load_model(), self._poses)
            self._event("/robot_description", {"data": urdf})
        self.note(f"episode {self._episode} begins")
        self._instant(rows)
        self._joint_states(rows["truth"])
        self._keep_state()

    def step(self, td: TensorDictBase, after: TensorDictBase) -> None:
        """Write a policy step and the instant after it."""
        self._note_change()
        self._ticks += 1
        self._episode_step += 1
        rows = self._rows(after)
        before = {
            key: value[self._robot].detach().numpy()
            for key in _CAUSES
            if (value := td.get(key, None)) is not None
        }
        if self._fast:
            self._substeps()
        else:
            self._joint_states(rows["truth"])
        self._place(rows)
        self._instant(rows)
        self._touchdowns(before, rows["truth"], self._planned(td))
        self._write_step(before, after, rows["truth"])
        done = bool(after.get("done")[self._robot])
        if done:
            self._note_end(after)
        # the last state lets a replay of a short episode be compared
        self._state_due = not (done or self._ticks % _STEPS_PER_SECOND == 0)
        if not self._state_due:
            self._keep_state()

    def note(self, text: str, level: int = messages.INFO) -> None:
        """Add a line to `/log`."""
        self._event("/log", messages.note(self._time, text, level))

    def finish(self) -> None:
        """Finish the file."""
        if self._state_due:
            self._keep_state()
        self._writer.finish(
            {"policy_steps": str(self._ticks - self._episode), "episodes": str(self._episode + 1)}
        )

    # ---------------------------------------------------------------- parts

    @property
    def _time(self) -> int:
        return self._ticks * _STEP_NS

    def _rows(self, td: TensorDictBase) -> dict[str, Row]:
        """Entries of the recorded robot by group."""
        robot = self._robot
        truth = cast("TensorDictBase", td.get("truth"))
        rows = {"truth": {k: v.numpy()[robot] for k, v in truth.items() if k in _TRUTH_READ}}
        for name in self._groups[1:]:
            rows[name] = _row(cast("TensorDictBase", td.get(name)), robot)
        if "estimate" in rows and "estimator" in td:
            rows["estimate"] |= _row(cast("TensorDictBase", td.get("estimator")), self._robot)
        if "reference" in rows:
            rows["reference"] |= {key: td.get(key)[robot].numpy() for key in _CLOCK if key in td}
        if "true_odometry" in rows:
            rows["true_odometry"]["heading"] = td.get("heading")[robot].numpy()
        if "sensors" in td:
            rows["sensors"] = _row(cast("TensorDictBase", td.get("sensors")), robot)
        if "observation" in td:
            rows["observation"] = {"observation": td.get("observation")[robot].numpy()}
        return rows

    def _place(self, rows: dict[str, Row]) -> None:
        """Compute all frame poses."""
        poses = self._poses
        self._kinematics.poses(rows["truth"]["qpos"], poses[: -len(ROM_FRAMES)])
        if "reference" in rows:
            rom = Ghost.of_rows(rows["reference"], rows["truth"])
            poses[-len(ROM_FRAMES) :, :3] = rom.body, rom.left, rom.right

    def _instant(self, rows: dict[str, Row]) -> None:
        """Write the topics that describe this instant."""
        for name, topic in self._flat.items():
            topic.write(self._time, rows[name])
        self._put(self._transforms, self._time, self._poses)

    def _write_step(self, before: Row, after: TensorDictBase, truth: Row) -> None:
        """Write `/step`: inputs and outcome."""
        row = {"push": _NO_PUSH, **before}
        row |= {key: truth[key] for key in ("ground_force", "diverged")}
        row |= {
            key: value[self._robot].detach().numpy() if value is not None else _NEVER
            for key in _OUTCOMES
            for value in [after.get(key, None)]
        }
        names = {key: key for key in row}
        if "reward_terms" in after:
            terms = _row(cast("TensorDictBase", after.get("reward_terms")), self._robot)
            names |= {key: f"term_{key}" for key in terms}
            row |= terms
        if self._step_topic is None:
            self._step_topic = _Entries(self._writer, "/step", row, np.float64, names)
        self._step_topic.write(self._time, row)

    def _keep_state(self) -> None:
        """Write a state for replays, and end the chunk."""
        state = self._base.states()[self._robot]
        values = np.concatenate([[self._episode, self._episode_step], state])
        if self._state is None or self._state.count != len(values):
            # a longer torque delay makes states longer
            integration = mujoco.mj_stateSize(self._base.model, _INTEGRATION)
            self._state = state_template(integration, len(state) - integration)
        data = self._state.encode(self._time, values)
        self._writer.write(self._state_channel, self._time, data)
        # written again, so that no state depends on an earlier chunk
        self._dynamics, self._stones = {}, np.zeros((0, len(STONE)))
        self._note_change()
        self._writer.flush()

    def _dynamics_row(self) -> Row:
        """Dynamics of the robot, a row of `/dynamics`."""
        row = {name: values[self._robot, None] for name, values in self._base.dynamics.items()}
        return row | {messages.MEMORY: self._base.model.actuator_history[0, :1].astype(float)}

    def _note_change(self) -> None:
        """Write `/dynamics` and `/stones` if they have changed since the last policy step."""
        if self._stones_topic is not None:
            stones = self._base.stones[self._robot]
            if len(stones) != self._most:
                raise ConfigurationError(
                    f"this log is of courses of up to {self._most} stones, got {len(stones)}; set"
                    " the longest course before it begins"
                )
            if not np.array_equal(stones, self._stones, equal_nan=True):
                self._stones = stones
                self._stones_topic.write(self._time, stones.ravel("F"))
        if self._dynamics and not self._base.altered:
            return
        row = self._dynamics_row()
        if row != self._dynamics:
            self._dynamics = row
            stiffness, damping = (float(row[key][0]) for key in _SPRINGS)
            self._kinematics.scale(stiffness, damping)
            self._dynamics_topic.write(self._time, row)

    def _touchdowns(self, before: Row, truth: Row, planned: Row | None) -> None:
        """Write `/touchdown` for feet that have just landed, with footholds of a plan, or gaits."""
        for i, force in enumerate(truth["ground_force"][:, 2].tolist()):
            airborne = self._airborne[i]
            self._airborne[i] = 0 if force > CONTACT_FORCE else airborne + 1
            if force <= CONTACT_FORCE or airborne < _AIRBORNE_STEPS:
                continue
            side, other = SIDES[i], SIDES[1 - i]
            foot, stance = (truth[f"{name}_foot_position"].astype(float) for name in (side, other))
            command = before.get("filtered_command", before["command"])
            speed = float(command[0])
            place = np.full(2, np.nan)
            if planned is not None:
                place = planned.get(side, place)
            elif self._footholds is not None:
                place = self._footholds.planned(
                    side, command.tolist(), stance, truth["pelvis_orientation"]
                )
            values = {"side": i, "x": foot[0], "y": foot[1], "x_planned": place[0]}
            values |= {"y_planned": place[1], "speed": speed}
            self._event("/touchdown", values)

    def _planned(self, td: TensorDictBase) -> Row | None:
        """Foot in swing -> its foothold (2,) in the world; None if the robot follows no plan."""
        if "plan" not in td:
            return None
        one = cast("TensorDictBase", td[self._robot : self._robot + 1])
        if not followed(one):
            return None
        return {SIDES[int(landing_foot(one))]: footholds_in_world(one)[0, 0, :2].double().numpy()}

    def _joint_states(self, truth: Row) -> None:
        """Write the joints of this instant."""
        entries = np.concatenate([truth[key] for key in ("qpos", "qvel", "motor_torque")])
        self._put(self._joints, self._time, self._kinematics.joints(entries))

    def _substeps(self) -> None:
        """Write the joints after each substep of the policy step."""
        start = self._time - _STEP_NS
        rows = self._kinematics.joints(self._base.watched)
        for substep, row in enumerate(rows):
            self._put(self._joints, start + (substep + 1) * _SUBSTEP_NS, row)

    def _note_end(self, after: TensorDictBase) -> None:
        terminated = bool(after.get("terminated")[self._robot])
        why = "terminated" if terminated else "truncated"
        level = messages.WARN if terminated else messages.INFO
        self.note(f"episode {self._episode} ends after {self._episode_step} steps: {why}", level)

    def _put(self, template: Template, time_ns: int, values: np.ndarray) -> None:
        self._writer.write(self._fixed[template], time_ns, template.encode(time_ns, values.ravel()))

    def _event(self, topic: str, message: Mapping[str, Any]) -> None:
        kind, channel = self._events[topic]
        self._writer.write(channel, self._time, kind.encode(message))


def _entries(group: str, row: Row) -> dict[str, str]:
    """Entries of a group's topic -> prefix of the names of their numbers."""
    if group == "truth":
        return {key: key for key in _TRUTH}
    return {key: _START.get(key, key) for key in row if key not in _UNLOGGED.get(group, ())}
