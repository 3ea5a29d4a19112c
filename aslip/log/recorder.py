"""Record one robot of an environment, as the last transform of its stack."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

from aslip.base.assets import user_path
from aslip.base.checks import check_count
from aslip.base.decorators import check_types
from aslip.envs import (
    SimulatedEnv,
    StackEnv,
    describe_transforms,
    library_of,
    observation_keys,
)
from aslip.errors import AslipError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.library.footholds import footholds_of
from aslip.log import JointRate, messages
from aslip.log.frozen_model import freeze_model, low_level_digest, model_digest
from aslip.log.session import Session
from aslip.log.writer import LogWriter, refuse_existing
from aslip.policy import POLICY_FILE, find_policy
from aslip.robot import CASSIE
from aslip.sim import PD

CONFIG_FILE = "config.json"
_PACKAGES = ("mujoco", "torch", "torchrl", "tensordict", "dm-control", "numpy", "mcap")


class Recorder(Transform):
    """Write everything about one robot to an MCAP file; the simulation is unchanged.

    The recorder must be the last transform of a stack, on any backend:

        stack = {**default_stack(library), "recorder": Recorder("walk.mcap")}
        env = make_env(stack=stack)  # env.transforms[-1] is its copy of the recorder
        env.rollout(400, load_policy("straight"))
        env.close()

    The file is complete after `close`, which is called when the environment is closed and when the
    program ends; until then it is `<path>.part`. A full disk ends the log with a warning, not the
    simulation. Log time is simulated time, zero at the first reset; a later reset
    takes the time of one policy step. See `aslip.log.messages` for topics. Planned footholds are
    those of the plan that a robot follows, or of the gaits of the stack's clock: NaN without a
    clock, or if feet do not swing once per stride.

    Args:
        path: log to write.
        robot: index of the robot in the environment.
        joint_rate: rate of `/joint_states`: that of the policy, or of the physics (2 kHz).
        policy: name or file of the acting policy, to attach.
        config: settings to attach: a dataclass, or JSON types.
        overwrite: replace an existing log when this one is finished.

    Raises:
        ConfigurationError: `joint_rate` is unknown; a log or an unfinished log of that name exists;
            a transform comes after this one; the environment has no such robot, or another low
            level than `PD`; or its model was changed by other means than
            `SimulatedEnv.set_dynamics`.
        AssetError: there is no such policy.
    """

    must_be_last = True
    """Marker for checks of the order of a stack."""

    @check_types
    def __init__(
        self,
        path: str | Path,
        *,
        robot: int = 0,
        joint_rate: JointRate = "policy",
        policy: str | Path | None = None,
        config: Any = None,
        overwrite: bool = False,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        if joint_rate not in ("policy", "physics"):
            raise ConfigurationError(
                f'joint_rate must be "policy" or "physics", got {joint_rate!r}'
            )
        self.path = user_path(path)
        refuse_existing(self.path, overwrite=overwrite)
        self._overwrite = overwrite
        self._robot = check_count("robot", robot, least=0)
        self._fast = joint_rate == "physics"
        self._policy = None if policy is None else find_policy(policy).read_bytes()
        settings: Any = config
        self._config = dataclasses.asdict(settings) if dataclasses.is_dataclass(config) else config
        self._session: Session | None = None
        self._closed = False
        self._finish: weakref.finalize | None = None

    @property
    def base_env(self) -> SimulatedEnv:
        """Simulated environment at the bottom of the stack."""
        env: Any = self.container
        while env is not None and not isinstance(env, SimulatedEnv):
            env = getattr(env, "base_env", None)
        if env is None:
            raise ConfigurationError("a Recorder must be in the stack of a SimulatedEnv")
        return env

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        if not self._closed and (mask is None or bool(mask.reshape(-1)[self._robot])):
            self._require_last()
            if self._session is None:
                self._session = self._begin(tensordict_reset)
                # finish the file when an unclosed environment is deleted or the program ends
                self._finish = weakref.finalize(self, _finish, self._session, os.getpid())
            self._session.reset(tensordict_reset)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self._closed:
            return next_tensordict
        if self._session is None:
            raise ConfigurationError("reset the environment before its first step is recorded")
        self._session.step(tensordict, next_tensordict)
        return next_tensordict

    def close(self) -> None:
        """Finish the file and stop recording."""
        self._closed, self._session = True, None
        if self._finish is not None:
            self._finish()

    def _require_last(self) -> None:
        """Raise ConfigurationError if another transform follows."""
        env: Any = self.container
        after = list(env.transform)[-1]
        if after is not self:
            raise ConfigurationError(
                f"the Recorder must be the last transform, because the log lacks the entries of"
                f" later ones; the last one is a {type(after).__name__}"
            )

    def _begin(self, tensordict: TensorDictBase) -> Session:
        base = self.base_env
        if not 0 <= self._robot < base.num_envs:
            raise ConfigurationError(
                f"cannot record robot {self._robot!r}: the environment has {base.num_envs}, from 0"
            )
        if base.make_drive is not PD:
            raise ConfigurationError(
                "a log replays under the low level `PD` only, so a Recorder cannot record"
                f" drive={base.make_drive!r}; drop the recorder"
            )
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
            "stack": describe_transforms(env),
            "settings": self._config,
        }
        files[CONFIG_FILE] = json.dumps(config, indent=1, default=str).encode()
        writer = LogWriter(self.path, overwrite=self._overwrite)
        try:
            library = _library_of(env)
            writer.attach(files, _metadata(base.model, config, library), _PACKAGES)
            names = _observed_names(env, tensordict)
            chosen = (self._robot, self._fast, None if library is None else footholds_of(library))
            return Session(writer, base, *chosen, tensordict, names)
        except BaseException as error:
            writer.discard()
            if isinstance(error, OSError) and not isinstance(error, AslipError):
                raise ConfigurationError(
                    f"cannot write the log {str(self.path)!r}: {error}"
                ) from error
            raise


def _library_of(env: StackEnv) -> GaitLibrary | None:
    """Gaits of a stack's clock; None without a clock."""
    try:
        return library_of(env)
    except ConfigurationError:
        return None


def _finish(session: Session, process: int) -> None:
    """Finish a log in the process that started it, not in a fork."""
    if os.getpid() == process:
        session.finish()


def _observed_names(env: StackEnv, td: TensorDictBase) -> list[str] | None:
    """Names of the numbers of the observation; None if it is not concatenated from entries."""
    try:
        keys = [key if isinstance(key, tuple) else (key,) for key in observation_keys(env)]
    except ConfigurationError:
        return None
    names = []
    for key in keys:
        size = td.get(key).shape[-1]
        start, last = "_".join(map(str, key[:-1])), str(key[-1])
        parts = messages.component_names(last, size)
        names += [f"{start}_{part}" if start else part for part in parts]
    fits = len(set(names)) == len(names) == td.get("observation").shape[-1]
    return names if fits else None


def _metadata(
    model: mujoco.MjModel, config: Mapping[str, Any], library: GaitLibrary | None
) -> dict[str, str]:
    """Metadata about the origin of a log."""
    return {
        "model_digest": model_digest(model),
        "low_level_digest": low_level_digest(),
        "gaits_sha256": "" if library is None else library.sha256,
        "seed": str(config["seed"]),
        "timestep_s": repr(float(model.opt.timestep)),
        "control_timestep_s": repr(CASSIE.physics_timestep),
        "substeps": str(CASSIE.substeps),
        "platform": f"{platform.system()} {platform.machine()}",
    }
