"""One log, from its first reset on: what is written when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import mujoco
import numpy as np
from tensordict import TensorDictBase

from aslip.cassie import PHYSICS_TIMESTEP, POLICY_PERIOD, SIDES, SUBSTEPS
from aslip.cassie.model import load_model
from aslip.envs import CassieEnv
from aslip.errors import ConfigurationError
from aslip.ghost import Footholds, Ghost
from aslip.log import messages
from aslip.log.kinematics import LoggedKinematics
from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES
from aslip.log.robot_description import robot_description
from aslip.log.template import Template, joints_template, state_template, transforms_template
from aslip.log.writer import LogWriter
from aslip.metrics.contact import CONTACT_FORCE

_SUBSTEP_NS = round(PHYSICS_TIMESTEP * 1e9)
_STEP_NS = SUBSTEPS * _SUBSTEP_NS
# a chunk, and a state to begin a replay from, once per simulated second
_STEPS_PER_SECOND = round(1 / POLICY_PERIOD)
# a foot touches down if it was in the air for as many steps before
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
# topics of named numbers, if the tensordict has them
_GROUPS = ("truth", "estimate", "reference")
_CLOCK = ("phase", "command")
# what a step depends on
_CAUSES = (*_CLOCK, "action", "motor_target", "push")
_OUTCOMES = ("reward", "terminated")
_NO_PUSH = np.zeros(3)
_START = {"faults": "fault"}
# the filter's insides, and what follows from gaits, phase and command but is of no use to look at
_UNLOGGED = {"estimate": {"memory"}, "reference": {"motor_velocity", "motor_torque"}}


def require_one_model(base: CassieEnv) -> None:
    """Check that the robots have the default model, the only one that a replay knows.

    Raises:
        ConfigurationError: their dynamics have been changed, or the physics has another timestep.
    """
    if base.model.opt.timestep != PHYSICS_TIMESTEP:
        raise ConfigurationError(
            f"logs are of physics with a timestep of {PHYSICS_TIMESTEP} s, this environment's is"
            f" {base.model.opt.timestep} s"
        )
    if base.altered:
        raise ConfigurationError(
            "the robots' dynamics have been changed (by RandomDynamics, set_dynamics or a reset),"
            " and a replay knows the default model only: record an environment of its own"
        )


# one robot's entries of a part of the tensordict
Row = dict[str, np.ndarray]


def _row(part: TensorDictBase, robot: int) -> Row:
    return {key: value.detach().numpy()[robot] for key, value in part.items()}


class _Flat:
    """A topic of named numbers, taken from a robot's entries in a fixed order.

    Args:
        writer: where messages go.
        topic: their topic; the type is named after it.
        entries: keys of the entries, and how the names of their numbers begin.
        sample: a row that has them.
        dtype: of the numbers.
    """

    def __init__(
        self,
        writer: LogWriter,
        topic: str,
        entries: Mapping[str, str],
        sample: Row,
        dtype: type[np.floating],
    ) -> None:
        self._writer, self._keys = writer, list(entries)
        names = [
            name
            for key, start in entries.items()
            for name in messages.component_names(start, sample[key].size)
        ]
        number = "float32" if dtype is np.float32 else "float64"
        kind = messages.flat_type(topic.strip("/").title(), number, names)
        self._template = Template(kind, lambda m: {name: m.number() for name in names}, dtype)
        self._channel = writer.open_channel(topic, kind)

    def write(self, time_ns: int, row: Row) -> None:
        """Add the message of a row."""
        values = np.concatenate([row[key].ravel() for key in self._keys])
        self._writer.write(self._channel, time_ns, self._template.encode(time_ns, values))


class Session:
    """A log from its first reset on."""

    def __init__(
        self,
        writer: LogWriter,
        base: CassieEnv,
        robot: int,
        fast: bool,
        footholds: Footholds,
        sample: TensorDictBase,
    ) -> None:
        self._writer, self._base, self._robot, self._fast = writer, base, robot, fast
        self._footholds = footholds
        self._ticks = -1  # policy steps and resets
        self._episode, self._episode_step = -1, 0
        self._airborne = [0, 0]
        self._state_due = False
        self._kinematics = LoggedKinematics(base.model)
        self._events = {
            topic: (kind, writer.open_channel(topic, kind))
            for topic, kind in (
                ("/robot_description", messages.STRING),
                ("/log", messages.LOG),
                ("/touchdown", messages.TOUCHDOWN),
            )
        }
        frames = [*self._kinematics.bodies, *ROM_FRAMES]
        self._poses = np.zeros((len(frames), 7))
        self._poses[:, 6] = 1.0
        self._transforms = transforms_template(frames)
        self._joints = joints_template(LOGGED_JOINTS)
        size = base.states().shape[1]
        self._integration = mujoco.mj_stateSize(base.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._state = state_template(self._integration, size - self._integration)
        self._fixed = {
            template: writer.open_channel(topic, template.kind)
            for topic, template in (
                ("/tf", self._transforms),
                ("/joint_states", self._joints),
                ("/state", self._state),
            )
        }
        self._groups = [name for name in _GROUPS if name in sample]
        rows = self._rows(sample)
        self._flat = {
            name: _Flat(writer, f"/{name}", _entries(name, rows[name]), rows[name], np.float32)
            for name in self._groups
        }
        self._step_topic: _Flat | None = None

    # --------------------------------------------------------------- events

    def reset(self, td: TensorDictBase) -> None:
        """The robot stands at the start of an episode."""
        require_one_model(self._base)
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
        """A policy step has passed."""
        require_one_model(self._base)
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
        self._touchdowns(before, rows["truth"])
        self._write_step(before, after, rows["truth"])
        done = bool(after.get("done")[self._robot])
        if done:
            self._note_end(after)
        # the last state of an episode, or a short one could not be compared with its replay
        self._state_due = not (done or self._ticks % _STEPS_PER_SECOND == 0)
        if not self._state_due:
            self._keep_state()

    def note(self, text: str, level: int = messages.INFO) -> None:
        """Add a line to `/log`."""
        self._event(
            "/log",
            {
                "stamp": messages.stamp(self._time),
                "level": level,
                "name": "aslip",
                "msg": text,
                "file": "",
                "function": "",
                "line": 0,
            },
        )

    def finish(self) -> None:
        """Complete the file."""
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
        """The recorded robot's entries of each group."""
        robot = self._robot
        truth = cast("TensorDictBase", td.get("truth"))
        rows = {"truth": {k: v.numpy()[robot] for k, v in truth.items() if k in _TRUTH_READ}}
        for name in self._groups[1:]:
            rows[name] = _row(cast("TensorDictBase", td.get(name)), robot)
        if "estimate" in rows and "estimator" in td:
            rows["estimate"] |= _row(cast("TensorDictBase", td.get("estimator")), self._robot)
        if "reference" in rows:
            rows["reference"] |= {key: td.get(key)[self._robot].numpy() for key in _CLOCK}
        return rows

    def _place(self, rows: dict[str, Row]) -> None:
        """Find out where everything is."""
        poses = self._poses
        self._kinematics.poses(rows["truth"]["qpos"], poses[: -len(ROM_FRAMES)])
        if "reference" in rows:
            rom = Ghost.of_rows(rows["reference"], rows["truth"])
            poses[-len(ROM_FRAMES) :, :3] = rom.body, rom.left, rom.right

    def _instant(self, rows: dict[str, Row]) -> None:
        """What is so at this instant."""
        for name, topic in self._flat.items():
            topic.write(self._time, rows[name])
        self._put(self._transforms, self._time, self._poses)

    def _write_step(self, before: Row, after: TensorDictBase, truth: Row) -> None:
        """What was done, and what came of it."""
        row = {"push": _NO_PUSH, **before}
        row |= {key: truth[key] for key in ("ground_force", "diverged")}
        row |= {key: after.get(key)[self._robot].detach().numpy() for key in _OUTCOMES}
        names = {key: key for key in row}
        if "reward_terms" in after:
            terms = _row(cast("TensorDictBase", after.get("reward_terms")), self._robot)
            names |= {key: f"term_{key}" for key in terms}
            row |= terms
        if self._step_topic is None:
            self._step_topic = _Flat(self._writer, "/step", names, row, np.float64)
        self._step_topic.write(self._time, row)

    def _keep_state(self) -> None:
        """A state to begin a replay from, and to compare one with; ends a chunk."""
        state = self._base.states()[self._robot]
        values = np.concatenate([[self._episode, self._episode_step], state])
        self._put(self._state, self._time, values)
        self._writer.flush()

    def _touchdowns(self, before: Row, truth: Row) -> None:
        """Tell of feet that have come down."""
        for i, force in enumerate(truth["ground_force"][:, 2].tolist()):
            airborne = self._airborne[i]
            self._airborne[i] = 0 if force > CONTACT_FORCE else airborne + 1
            if force <= CONTACT_FORCE or airborne < _AIRBORNE_STEPS:
                continue
            side, other = SIDES[i], SIDES[1 - i]
            foot, stance = (truth[f"{name}_foot_position"].astype(float) for name in (side, other))
            speed = float(before["command"][0])
            planned = self._footholds.planned(side, speed, stance, truth["pelvis_orientation"])
            values = {"side": i, "x": foot[0], "y": foot[1], "x_planned": planned[0]}
            values |= {"y_planned": planned[1], "speed": speed}
            self._event("/touchdown", values)

    def _joint_states(self, truth: Row) -> None:
        """Joints at this instant."""
        entries = np.concatenate([truth[key] for key in ("qpos", "qvel", "motor_torque")])
        self._put(self._joints, self._time, self._kinematics.joints(entries))

    def _substeps(self) -> None:
        """Joints after each of the policy step's substeps."""
        start = self._time - _STEP_NS
        rows = self._kinematics.joints(self._base.watched)
        for substep, row in enumerate(rows):
            self._put(self._joints, start + (substep + 1) * _SUBSTEP_NS, row)

    def _note_end(self, after: TensorDictBase) -> None:
        terminated = bool(after.get("terminated")[self._robot])
        diverged = bool(after.get(("truth", "diverged"))[self._robot])
        why = "the simulation diverged" if diverged else "terminated" if terminated else "truncated"
        level = messages.WARN if terminated else messages.INFO
        self.note(f"episode {self._episode} ends after {self._episode_step} steps: {why}", level)

    def _put(self, template: Template, time_ns: int, values: np.ndarray) -> None:
        self._writer.write(self._fixed[template], time_ns, template.encode(time_ns, values.ravel()))

    def _event(self, topic: str, message: Mapping[str, Any]) -> None:
        kind, channel = self._events[topic]
        self._writer.write(channel, self._time, kind.encode(message))


def _entries(group: str, row: Row) -> dict[str, str]:
    """Entries that a group's topic has, and how the names of their numbers begin."""
    if group == "truth":
        return {key: key for key in _TRUTH}
    return {key: _START.get(key, key) for key in row if key not in _UNLOGGED[group]}
