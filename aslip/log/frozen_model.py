"""A compiled model as the bytes it was made from and what was changed since: exact, and readable.

MuJoCo's own XML writer rounds to six digits, which a walking robot notices within seconds.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import aslip
from aslip.assets import asset_path
from aslip.errors import ConfigurationError, FileDamagedError

MODEL_FILE = "model.xml"
CHANGES_FILE = "model.json"


def freeze_model(model: mujoco.MjModel) -> dict[str, bytes]:
    """Files from which `thaw_model` makes the same model, to the bit.

    Args:
        model: compiled from `assets/cassie.xml`, with any numbers changed since.

    Raises:
        ConfigurationError: the model has other parts than the file.
    """
    xml = asset_path("cassie.xml").read_bytes()
    for visual in (False, True):
        original = _compile(xml, visual)
        if original.ngeom == model.ngeom and original.nq == model.nq:
            changes = {"visual": visual, "fields": list(_changes(original, model))}
            return {MODEL_FILE: xml, CHANGES_FILE: json.dumps(changes, indent=1).encode()}
    raise ConfigurationError(
        f"cannot log a model with {model.nq} positions and {model.ngeom} geoms: assets/cassie.xml"
        f" has {original.nq} and {original.ngeom}"
    )


def thaw_model(files: dict[str, bytes]) -> mujoco.MjModel:
    """The model that `freeze_model` was given.

    Raises:
        FileDamagedError: the files are not what it made.
    """
    try:
        changes = json.loads(files[CHANGES_FILE])
        model = _compile(files[MODEL_FILE], changes["visual"])
        for path, index, value in changes["fields"]:
            owner, name = _owner(model, path)
            if index:
                getattr(owner, name)[tuple(index)] = value
            else:
                setattr(owner, name, value)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise FileDamagedError(
            f"the model of the log cannot be built ({type(error).__name__}: {error})"
        ) from error
    return model


def model_digest(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def _compile(xml: bytes, visual: bool) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(xml.decode())
    spec.compiler.discardvisual = not visual
    return spec.compile()


def _changes(original: mujoco.MjModel, model: mujoco.MjModel) -> Iterator[list[Any]]:
    """Numbers that differ: where, index, and value."""
    for prefix in ("", "opt."):
        names = dir(original if not prefix else original.opt)
        for name in (n for n in names if not n.startswith("_")):
            old, new = (getattr(*_owner(m, prefix + name)) for m in (original, model))
            if isinstance(old, np.ndarray) and old.dtype != object:
                for index in np.argwhere(old != new):
                    yield [prefix + name, index.tolist(), new[tuple(index)].item()]
            elif isinstance(old, int | float) and old != new:
                yield [prefix + name, [], new]


def _owner(model: mujoco.MjModel, path: str) -> tuple[Any, str]:
    return (model.opt, path.removeprefix("opt.")) if path.startswith("opt.") else (model, path)


def low_level_digest() -> str:
    """SHA-256 of the code between motor targets and physics: `aslip.cassie` and `aslip.sim`."""
    package = Path(aslip.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(p for name in ("cassie", "sim") for p in (package / name).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
