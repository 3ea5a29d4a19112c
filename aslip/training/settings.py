"""Settings of trainings and programs: checks and file.

The module does not import PyTorch, so that command lines are parsed at once.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from aslip.base.checks import check_count
from aslip.errors import ConfigurationError, FileDamagedError

SETTINGS_FILE = "config.json"
"""File of a run's settings, in its folder."""

LoggerName = Literal["none", "tensorboard", "wandb", "mlflow"]
"""Logger that gets settings, the numbers of each update, and films; see `ProgressLog`."""

# number of differences in an error message, and characters of each
_SHOWN, _SHOWN_TEXT = 4, 60
_TRANSFORMS, _COMMAND = "transforms", "first_command"  # beside the settings


def read_settings(folder: Path) -> tuple[dict[str, Any], dict[str, str], str]:
    """Settings of the run in a folder, description of each of its transforms, and first command.

    Raises:
        ConfigurationError: the folder holds no run.
        FileDamagedError: the file cannot be read.
    """
    path = folder / SETTINGS_FILE
    if not path.is_file():
        raise ConfigurationError(
            f"{str(folder)!r} holds no run to resume; start one without --resume, or name the"
            " folder of a run with --out"
        )
    try:
        settings = dict(json.loads(path.read_text(encoding="utf-8")))
        transforms, command = settings.pop(_TRANSFORMS, {}), settings.pop(_COMMAND, "")
        return settings, dict(transforms), str(command)
    except (ValueError, TypeError) as error:
        raise FileDamagedError(f"{str(path)!r} is damaged ({error})") from error


def say_loading(folder: Path) -> None:
    """Say that a training begins, before imports that take seconds."""
    print(f"{folder}: loading libraries and robots", flush=True)


def settings_text(settings: dict[str, Any], transforms: dict[str, str], command: str) -> str:
    """Content of the file that `read_settings` reads."""
    about = {**settings, _TRANSFORMS: transforms, _COMMAND: command}
    return json.dumps(about, indent=1) + "\n"


def differences(
    old: Mapping[str, Any], new: Mapping[str, Any], may_differ: Sequence[str] = ()
) -> list[str]:
    """Descriptions of the first settings that differ; long ones start near the difference."""
    texts = []
    for name in sorted((old.keys() | new.keys()) - {*may_differ}):
        before, now = repr(old.get(name)), repr(new.get(name))
        if before != now:
            pairs = enumerate(zip(before, now, strict=False))
            same = next((i for i, (a, b) in pairs if a != b), 0)
            start = max(0, same - _SHOWN_TEXT // 2)
            was, is_ = (text[start : start + _SHOWN_TEXT] for text in (before, now))
            texts.append(f"{name} was {was} and is {is_}")
    return texts[:_SHOWN]


def check_types(config: Any) -> None:
    """Check the type of each setting of a dataclass; integers pass as floats.

    Raises:
        ConfigurationError: a setting has another type, or is a float that is not finite.
    """
    for name, kind in get_type_hints(type(config)).items():
        value = getattr(config, name)
        if get_origin(kind) is Literal:
            fits, wanted = isinstance(value, str) and value in get_args(kind), f"{get_args(kind)}"
        elif kind is float:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            fits = number and abs(value) <= sys.float_info.max
            wanted = "a finite number"
        else:
            fits = isinstance(value, kind) and isinstance(value, bool) == (kind is bool)
            wanted = {int: "an integer", bool: "True or False"}.get(
                kind, f"a {getattr(kind, '__name__', kind)}"
            )
        if not fits:
            raise ConfigurationError(f"{name} must be {wanted}, got {value!r}")


def check_positive(config: Any, *names: str) -> None:
    """Check that settings are positive.

    Raises:
        ConfigurationError: a setting is not.
    """
    for name in names:
        if getattr(config, name) <= 0:
            raise ConfigurationError(f"{name} must be positive, got {getattr(config, name)}")


def check_range(config: Any, low: float, high: float, *names: str) -> None:
    """Check that settings are within a range, ends included.

    Raises:
        ConfigurationError: a setting is not.
    """
    for name in names:
        if not low <= getattr(config, name) <= high:
            allowed = f"{low} or more" if high == math.inf else f"from {low} to {high}"
            raise ConfigurationError(f"{name} must be {allowed}, got {getattr(config, name)}")


def check_shares(num_envs: int, samples: int, num_collectors: int = 1) -> None:
    """Check that robots divide equally among collectors, and samples among robots.

    Raises:
        ConfigurationError: a division has a remainder, or there is no collector.
    """
    check_count("num_collectors", num_collectors)
    if num_envs % num_collectors:
        raise ConfigurationError(
            f"num_envs must be a multiple of num_collectors = {num_collectors}, got {num_envs}"
        )
    if samples % num_envs:
        raise ConfigurationError(
            f"samples must be a multiple of num_envs = {num_envs}, got {samples}"
        )
