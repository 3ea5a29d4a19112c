"""Compiled models of logs: an MJCF, named by its hash, and the settings it was compiled with.

MuJoCo's own XML writer rounds to six digits, enough to change a walk within seconds, so a log names
the shipped MJCF. Other differences between robots are logged as parameters of `aslip.sim.DYNAMICS`.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

import aslip
from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.log.reader import Recording
from aslip.log.writer import HASH_KEY
from aslip.robot import CASSIE
from aslip.robot.model import STONE_GEOM, ground_geoms, load_model
from aslip.sim.course import MOST_STONES

MODEL_FILE: Final = "model.xml"
SETTINGS_FILE: Final = "model.json"

LONGEST_MEMORY: Final = 2 * CASSIE.substeps
"""Longest memory of torque commands of a motor: a policy step, rounded up by doubling."""


def freeze_model(model: mujoco.MjModel) -> dict[str, bytes]:
    """Files from which `thaw_model` compiles the model again, bit for bit.

    Args:
        model: model from `aslip.robot.model.load_model`.

    Raises:
        ConfigurationError: the model is not the shipped MJCF with other settings of `load_model`.
    """
    digest = model_digest(model)
    for visual in (False, True):
        settings = {
            "visual": visual,
            "timestep": float(model.opt.timestep),
            "memory": int(model.actuator_history[0, 0]),
            "floor_friction": float(model.geom("floor").friction[0]),
        }
        if stones := len(ground_geoms(model, STONE_GEOM)):
            settings["stones"] = stones
        if model_digest(load_model(**settings)) == digest:
            files = {SETTINGS_FILE: json.dumps(settings, indent=1).encode()}
            return {MODEL_FILE: CASSIE.mjcf.read_bytes(), **files}
    raise ConfigurationError(
        f"cannot log this model, which differs from {CASSIE.mjcf.name}; change robots by"
        " set_dynamics or RandomDynamics, and use rectangular stones only"
    )


def thaw_model(
    recording: Recording, path: Path | None = None, memory: int | None = None
) -> mujoco.MjModel:
    """Compile the model of a log.

    Args:
        recording: the log; its settings must be in the ranges of `load_model`.
        path: MJCF; the shipped one by default.
        memory: number of torque commands in the memory of a motor; as logged by default.

    Raises:
        FileDamagedError: the settings are damaged or out of range, or the MJCF cannot be compiled.
    """
    path = CASSIE.mjcf if path is None else path
    try:
        settings = json.loads(recording.attachment(SETTINGS_FILE))
        if memory is not None:
            settings["memory"] = memory
        if settings["memory"] not in range(1, LONGEST_MEMORY + 1):
            raise ValueError(f"memory must be from 1 to {LONGEST_MEMORY} commands, got {settings}")
        if settings.get("stones", 0) not in range(MOST_STONES + 1):
            raise ValueError(f"stones must be up to {MOST_STONES}, got {settings}")
        return load_model(**settings, robot=replace(CASSIE, model_file=path))
    except (KeyError, TypeError, RecursionError, ValueError) as error:
        reason = str(error) if isinstance(error, AslipError) else f"{type(error).__name__}: {error}"
        raise FileDamagedError(
            f"the model of the log cannot be compiled from {str(path)!r}: {reason}"
        ) from error


def is_known(recording: Recording, model: mujoco.MjModel) -> bool:
    """True if a log is of the shipped MJCF, by the hash of the file or of the compiled model."""
    named = recording.metadata.get(HASH_KEY + MODEL_FILE)
    shipped = hashlib.sha256(CASSIE.mjcf.read_bytes()).hexdigest()
    return named == shipped or model_digest(model) == recording.metadata.get("model_digest")


def model_digest(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def low_level_digest() -> str:
    """SHA-256 of the code between motor targets and physics: `aslip.robot` and `aslip.sim`."""
    package = Path(aslip.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(p for name in ("robot", "sim") for p in (package / name).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
