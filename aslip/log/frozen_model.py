"""Compiled models as an MJCF and a few settings: exact, readable, and safe to load.

MuJoCo's own XML writer rounds to six digits, enough to change a walk within seconds. A log from an
untrusted source does no harm: its XML may differ from the shipped one in numbers only, settings
have ranges, and no field of the model is set by name or index. Other differences between robots are
logged as parameters of `aslip.sim.DYNAMICS`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import mujoco
import numpy as np

import aslip
from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.robot import CASSIE
from aslip.robot.model import HIGHEST_FRICTION, check_timestep, set_floor_friction

MODEL_FILE: Final = "model.xml"
SETTINGS_FILE: Final = "model.json"

LONGEST_MEMORY: Final = 2 * CASSIE.substeps
"""Longest memory of torque commands of a motor: a policy step, rounded up by doubling."""
# largest number in the XML, relative to the shipped one
_LARGEST_FACTOR = 10.0


@dataclass(frozen=True)
class ModelSettings:
    """Settings with which a model is compiled.

    Raises:
        ConfigurationError: a value has the wrong type or is out of range.
    """

    visual: bool
    """Compile the visual geoms, too."""
    timestep: float
    """Physics timestep [s]."""
    memory: int
    """Number of torque commands in the memory of a motor."""
    floor_friction: float
    """Sliding friction of the floor."""

    def __post_init__(self) -> None:
        """Check types and ranges."""
        for name, kind in (("visual", bool), ("timestep", float), ("memory", int)):
            if type(getattr(self, name)) is not kind:
                raise ConfigurationError(f"{name} must be of type {kind.__name__}, got {self}")
        check_timestep(self.timestep)
        if not 1 <= self.memory <= LONGEST_MEMORY:
            raise ConfigurationError(
                f"memory must be from 1 to {LONGEST_MEMORY} commands, got {self.memory!r}"
            )
        friction = self.floor_friction
        if type(friction) is not float or not 0 < friction <= HIGHEST_FRICTION:
            raise ConfigurationError(
                f"floor_friction must be over 0 and up to {HIGHEST_FRICTION:g}, got {friction!r}"
            )

    @classmethod
    def of(cls, model: mujoco.MjModel, *, visual: bool) -> ModelSettings:
        """Settings of a compiled model."""
        return cls(
            visual=visual,
            timestep=float(model.opt.timestep),
            memory=int(model.actuator_history[0, 0]),
            floor_friction=float(model.geom("floor").friction[0]),
        )


def freeze_model(model: mujoco.MjModel) -> dict[str, bytes]:
    """Files from which `thaw_model` compiles the model again, bit for bit.

    Args:
        model: model from `aslip.robot.model.load_model`.

    Raises:
        ConfigurationError: the model differs from the shipped MJCF in more than `ModelSettings`.
    """
    xml = CASSIE.mjcf.read_bytes()
    differ: list[str] = []
    for visual in (False, True):
        settings = ModelSettings.of(model, visual=visual)
        frozen = {MODEL_FILE: xml, SETTINGS_FILE: json.dumps(asdict(settings), indent=1).encode()}
        thawed = thaw_model(frozen)
        if model_digest(thawed) == model_digest(model):
            return frozen
        if thawed.ngeom == model.ngeom and thawed.nq == model.nq:
            differ = _differing(thawed, model)
    shipped = CASSIE.mjcf.name
    found = f"differs from {shipped} in {differ}" if differ else f"is not compiled from {shipped}"
    raise ConfigurationError(
        f"cannot log this model, which {found}; change robots by set_dynamics or RandomDynamics"
    )


def thaw_model(files: Mapping[str, bytes], memory: int | None = None) -> mujoco.MjModel:
    """Compile the model from the files of `freeze_model`.

    Args:
        files: result of `freeze_model`, possibly from an untrusted log.
        memory: number of torque commands in the memory of a motor; as stored by default.

    Raises:
        FileDamagedError: the files cannot be compiled, or differ in structure from the shipped
            MJCF.
    """
    try:
        given = json.loads(files[SETTINGS_FILE])
        settings = ModelSettings(**given if memory is None else {**given, "memory": memory})
        _check_structure(files[MODEL_FILE])
        spec = mujoco.MjSpec.from_string(files[MODEL_FILE].decode())
        spec.compiler.discardvisual = not settings.visual
        spec.option.timestep = settings.timestep
        for actuator in spec.actuators:
            actuator.nsample = settings.memory
        model = spec.compile()
        set_floor_friction(model, settings.floor_friction)
    except KeyError as error:
        raise FileDamagedError(f"the model of the log lacks {error}") from error
    except (TypeError, ValueError, RecursionError, SyntaxError, mujoco.FatalError) as error:
        reason = str(error) if isinstance(error, AslipError) else f"{type(error).__name__}: {error}"
        raise FileDamagedError(f"the model of the log cannot be built: {reason}") from error
    return model


def model_digest(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def _check_structure(xml: bytes) -> None:
    """Check that an MJCF has the structure of the shipped one.

    Raises:
        ValueError: the files differ in more than numbers, or a number is out of range.
    """
    own = CASSIE.mjcf.read_bytes()
    if xml == own:
        return
    ours, theirs = (ElementTree.fromstring(text) for text in (own, xml))
    for one, other in zip_longest(ours.iter(), theirs.iter()):
        if one is None or other is None or (one.tag, len(one)) != (other.tag, len(other)):
            raise ValueError(f"{MODEL_FILE} has other elements than {CASSIE.mjcf.name}")
        if one.keys() != other.keys():
            raise ValueError(f"<{one.tag}> has other attributes than in {CASSIE.mjcf.name}")
        for key, text in one.items():
            if not _alike(text, other.get(key, "")):
                raise ValueError(f"<{one.tag} {key}={other.get(key)!r}> cannot replace {text!r}")


def _alike(ours: str, theirs: str) -> bool:
    """True if two attributes are equal, or numbers of the same order of magnitude."""
    if ours == theirs:
        return True
    one, other = (_numbers(text) for text in (ours, theirs))
    return len(one) == len(other) > 0 and all(
        math.isfinite(b) and abs(b) <= _LARGEST_FACTOR * max(abs(a), 1.0)
        for a, b in zip(one, other, strict=True)
    )


def _numbers(text: str) -> list[float]:
    """Parse the numbers of an attribute; empty if it has other words."""
    words = text.split()
    if not all(re.fullmatch(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?", word) for word in words):
        return []
    return [float(word) for word in words]


def _differing(one: Any, other: Any) -> list[str]:
    """Names of fields that differ between two models."""
    names = []
    for prefix, a, b in (("", one, other), ("opt.", one.opt, other.opt)):
        for name in (n for n in dir(a) if not n.startswith("_")):
            old, new = getattr(a, name), getattr(b, name)
            if isinstance(old, np.ndarray | int | float) and not np.array_equal(old, new):
                names.append(prefix + name)
    return names


def low_level_digest() -> str:
    """SHA-256 of the code between motor targets and physics: `aslip.robot` and `aslip.sim`."""
    package = Path(aslip.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(p for name in ("robot", "sim") for p in (package / name).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
