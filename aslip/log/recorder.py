"""Record one robot of an environment, as the last transform of its stack."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, cast

import mujoco
import numpy as np
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

import aslip
from aslip.assets import asset_path
from aslip.cassie import MOTOR_NAMES, PHYSICS_TIMESTEP, POLICY_PERIOD, SIDES, SUBSTEPS
from aslip.cassie.model import load_model
from aslip.envs import CassieEnv
from aslip.errors import ConfigurationError
from aslip.ghost import Footholds, Ghost
from aslip.library import GaitLibrary
from aslip.log import messages
from aslip.log.frozen_model import freeze_model, model_digest
from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES, WORLD_FRAME
from aslip.log.robot_description import robot_description
from aslip.log.template import Marks, Template
from aslip.log.writer import LogWriter
from aslip.policy import find_policy

JointRate = Literal["policy", "physics"]

CONFIG_FILE = "config.json"
POLICY_FILE = "policy.zip"

_SUBSTEP_NS = round(PHYSICS_TIMESTEP * 1e9)
_STEP_NS = SUBSTEPS * _SUBSTEP_NS
# a chunk, and a state to begin a replay from, once per simulated second
_STEPS_PER_SECOND = round(1 / POLICY_PERIOD)
# a foot that carries more has touched down [N], if it was in the air for as many steps before
_TOUCHDOWN_FORCE = 20.0
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


class Recorder(Transform):
    """Writes everything about one robot to an MCAP file, and changes nothing.

    It must be the last of a stack's transforms, whichever backend they are on:

        stack = {**default_stack(library), "recorder": lambda: Recorder("walk.mcap")}
        env = make_env(stack=stack)
        env.rollout(400, load_policy("aslip"))
        env.close()

    The file is complete once `close` was called, which closing the environment does; until then it
    is `<path>.part`. Log time is simulated time, zero at the first reset; a later reset takes the
    time of one policy step. See `aslip.log.messages` for topics.

    Args:
        path: of the log.
        robot: which robot of the environment.
        joint_rate: `/joint_states` at the policy's rate or at that of the physics, 2 kHz.
        policy: name or file of the policy that acts, to be attached.
        config: settings to be attached, a dataclass or of JSON types.
        library: the gaits, for planned footholds; the shipped ones by default.

    Raises:
        ConfigurationError: `joint_rate` is neither; there is an unfinished log of that name; the
            environment has no such robot; the model cannot be logged; or robots have been given
            dynamics that differ from it.
        AssetError: there is no such policy.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        robot: int = 0,
        joint_rate: JointRate = "policy",
        policy: str | Path | None = None,
        config: Any = None,
        library: GaitLibrary | None = None,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        if joint_rate not in ("policy", "physics"):
            raise ConfigurationError(f'joint_rate is "policy" or "physics", got {joint_rate!r}')
        self.path = Path(path)
        self._robot = robot
        self._fast = joint_rate == "physics"
        self._policy = None if policy is None else find_policy(policy).read_bytes()
        settings: Any = config
        self._config = dataclasses.asdict(settings) if dataclasses.is_dataclass(config) else config
        self._footholds = Footholds(GaitLibrary.load() if library is None else library)
        self._session: _Session | None = None

    @property
    def base_env(self) -> CassieEnv:
        """The environment whose robots are simulated."""
        env: Any = self.container
        while env is not None and not isinstance(env, CassieEnv):
            env = getattr(env, "base_env", None)
        if env is None:
            raise ConfigurationError("a Recorder must be in the stack of a CassieEnv")
        return env

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        if mask is None or bool(mask.reshape(-1)[self._robot]):
            if self._session is None:
                self._session = self._begin(tensordict_reset)
            self._session.reset(tensordict_reset)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self._session is None:
            raise ConfigurationError("reset the environment before its first step is recorded")
        self._session.step(tensordict, next_tensordict)
        return next_tensordict

    def note(self, text: str) -> None:
        """Add a line to the log's `/log`, at the present time."""
        if self._session is not None:
            self._session.note(text)

    def close(self) -> None:
        """Finish the file; nothing more is recorded until the next reset of a new recorder."""
        if self._session is not None:
            self._session.finish()
            self._session = None

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _begin(self, tensordict: TensorDictBase) -> _Session:
        base = self.base_env
        if not 0 <= self._robot < base.num_envs:
            raise ConfigurationError(
                f"no robot {self._robot!r} to record; the environment has {base.num_envs}, from 0"
            )
        _require_one_model(base)
        if self._fast:
            base.watch(self._robot)
        files = freeze_model(base.model)
        if self._policy is not None:
            files[POLICY_FILE] = self._policy
        env: Any = self.container
        config = {
            "robot": self._robot,
            "num_envs": base.num_envs,
            "backend": type(base).__name__,
            "seed": getattr(env, "seed", None),
            "stack": {
                name: type(transform).__name__
                for name, transform in zip(env.transform_names, env.transforms, strict=True)
            },
            "settings": self._config,
        }
        files[CONFIG_FILE] = json.dumps(config, indent=1, default=str).encode()
        writer = LogWriter(self.path)
        try:
            writer.attach(files, _metadata(base.model, config))
            return _Session(writer, base, self._robot, self._fast, self._footholds, tensordict)
        except BaseException:
            writer.discard()
            raise


def _require_one_model(base: CassieEnv) -> None:
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


class _Session:
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
        self._kinematics = _Kinematics(base.model)
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
        self._transforms = _transforms_template(frames)
        self._joints = _joints_template(LOGGED_JOINTS)
        size = base.states().shape[1]
        self._integration = mujoco.mj_stateSize(base.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._state = _state_template(self._integration, size - self._integration)
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
        _require_one_model(self._base)
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
        _require_one_model(self._base)
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
            self._airborne[i] = 0 if force > _TOUCHDOWN_FORCE else airborne + 1
            if force <= _TOUCHDOWN_FORCE or airborne < _AIRBORNE_STEPS:
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


class _Kinematics:
    """Poses of all bodies, and joints as viewers want them, from the state."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._xpos, self._xquat = self._data.xpos[1:], self._data.xquat[1:]
        self.bodies = [model.body(i).name for i in range(1, model.nbody)]
        joints = [model.joint(name) for name in LOGGED_JOINTS]
        passive = joints[len(MOTOR_NAMES) :]
        qpos = np.array([joint.qposadr[0] for joint in joints])
        qvel = np.array([joint.dofadr[0] for joint in joints])
        motors = np.arange(model.nu)
        # columns of `CassieEnv.watched`
        self._columns = np.concatenate([qpos, model.nq + qvel, model.nq + model.nv + motors])
        self._rest = model.qpos_spring[qpos[len(motors) :]]
        self._stiffness = np.array([joint.stiffness[0] for joint in passive])
        self._damping = np.array([joint.damping[0] for joint in passive])

    def poses(self, qpos: np.ndarray, out: np.ndarray) -> None:
        """Put positions [m] and quaternions (xyzw) of all bodies but the world into (b, 7)."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        out[:, :3], out[:, 3:6], out[:, 6] = self._xpos, self._xquat[:, 1:], self._xquat[:, 0]

    def joints(self, rows: np.ndarray) -> np.ndarray:
        """Positions, velocities and efforts of `LOGGED_JOINTS`, from `qpos`, `qvel` and torques.

        Args:
            rows: (*b, 77 or more) as `CassieEnv.watched` has them.

        Returns:
            (*b, 48). The effort of a motor is its torque at the joint, of a spring what it and its
            damper exert [N m].
        """
        count, motors = len(LOGGED_JOINTS), self._model.nu
        values = rows[..., self._columns]
        angle, velocity = values[..., motors:count], values[..., count + motors : 2 * count]
        effort = self._stiffness * (self._rest - angle) - self._damping * velocity
        return np.concatenate([values, effort], axis=-1)


def _entries(group: str, row: Row) -> dict[str, str]:
    """Entries that a group's topic has, and how the names of their numbers begin."""
    if group == "truth":
        return {key: key for key in _TRUTH}
    return {key: _START.get(key, key) for key in row if key not in _UNLOGGED[group]}


def _transforms_template(frames: Sequence[str]) -> Template:
    def build(marks: Marks) -> dict[str, Any]:
        return {"transforms": [_transform(frame, marks) for frame in frames]}

    return Template(messages.TRANSFORMS, build)


def _transform(frame: str, marks: Marks) -> dict[str, Any]:
    return {
        "header": {"stamp": marks.stamp(), "frame_id": WORLD_FRAME},
        "child_frame_id": frame,
        "transform": {
            "translation": {axis: marks.number() for axis in "xyz"},
            "rotation": {axis: marks.number() for axis in "xyzw"},
        },
    }


def _joints_template(names: Sequence[str]) -> Template:
    def build(marks: Marks) -> dict[str, Any]:
        columns = {key: marks.numbers(len(names)) for key in ("position", "velocity", "effort")}
        return {"header": {"stamp": marks.stamp(), "frame_id": ""}, "name": list(names), **columns}

    return Template(messages.JOINT_STATE, build)


def _state_template(integration: int, sensors: int) -> Template:
    def build(marks: Marks) -> dict[str, Any]:
        return {
            "episode": marks.number(),
            "step": marks.number(),
            "integration": marks.numbers(integration),
            "sensors": marks.numbers(sensors),
        }

    return Template(messages.STATE, build)


def _metadata(model: mujoco.MjModel, config: Mapping[str, Any]) -> dict[str, str]:
    """How the log was made."""
    versions = {
        f"version/{name}": importlib.metadata.version(name)
        for name in ("mujoco", "torch", "torchrl", "tensordict", "dm-control", "numpy", "mcap")
    }
    return {
        "format": messages.FORMAT,
        "version/aslip": aslip.__version__,
        "version/python": platform.python_version(),
        **versions,
        "model_digest": model_digest(model),
        "low_level_digest": low_level_digest(),
        "gaits_sha256": hashlib.sha256(asset_path("gaits.npz").read_bytes()).hexdigest(),
        "seed": str(config["seed"]),
        "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "timestep_s": repr(PHYSICS_TIMESTEP),
        "substeps": str(SUBSTEPS),
        "platform": f"{platform.system()} {platform.machine()}",
    }


def low_level_digest() -> str:
    """SHA-256 of the code between motor targets and physics: `aslip.cassie` and `aslip.sim`."""
    package = Path(aslip.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(p for name in ("cassie", "sim") for p in (package / name).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
