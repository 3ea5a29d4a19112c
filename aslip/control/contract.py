"""Contract of an exported policy, in the metadata of its ONNX file; needs no PyTorch.

| key | content |
|---|---|
| `run_path`, `joint_names`, `joint_stiffness`, `joint_damping`, `default_joint_pos`, `command_names`, `observation_names`, `action_scale` | keys of mjlab, comma-separated, in full precision |
| `interface` | `inputs` and `outputs` of the graph with unit and frame, and `feedback`, as JSON |
| `aslip` | robot, rates, limits, library, policy and versions, as JSON |
| `golden_trace` | 200 policy steps, an `.npz` in base64 |
| `sha256` | SHA-256 of all bytes of the file before this entry, which is the last |
"""  # noqa: E501

from __future__ import annotations

import base64
import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from aslip.base.archive import from_npy, read_zip
from aslip.errors import AslipError, ConfigurationError, FileDamagedError, machine_failed
from aslip.robot import Robot

CONTRACT_VERSION: Final = 3
"""Version of the contract; files of other versions are refused."""

TOLERANCE: Final = 1e-5
"""Largest difference of a motor target between an exported policy and PyTorch [rad].

Sums over the components of a library differ by a unit in the last place, which the network enlarges
to 1e-6 rad; an encoder of Cassie resolves 8e-4 rad."""

# fields of a robot in the entry `aslip`; mjlab has keys for motor names and gains
_ROBOT_FIELDS = (
    *("joint_names", "gear", "torque_limit", "no_load_speed", "torque_delay"),
    *("physics_timestep", "substeps", "packet_substeps", "packet_sizes", "estimate_sizes"),
)
# Protocol Buffers bytes of the last metadata entry (field 14), up to its 64 hexadecimal digits
_SEAL = b"\x72\x4a\x0a\x06sha256\x12\x40"
_SEAL_SIZE = len(_SEAL) + 64
# name of the entry that points to a file beside the model, in any encoding of the entry
_EXTERNAL = b"location"


@dataclass(frozen=True)
class Contract:
    """Contract of an exported policy."""

    metadata: Mapping[str, str]
    """Metadata of the file: all entries but the hash."""
    about: Mapping[str, Any]
    """Entry `aslip`: `contract`, `aslip`, `robot`, `library`, `policy`, `baseline`,
    `policy_period`, `motor_lead`, `command_rates`."""
    inputs: Sequence[Mapping[str, Any]]
    """Inputs of the graph: `name`, `dtype`, `shape`, and where they apply `elements`, `unit`,
    `frame` and `meaning`."""
    outputs: Sequence[Mapping[str, Any]]
    """Outputs of the graph, described as the inputs are."""
    feedback: Mapping[str, str]
    """Output -> input that takes its value at the next policy step."""

    @classmethod
    def of(cls, metadata: Mapping[str, str]) -> Contract:
        """Read the contract from the metadata of a file.

        Raises:
            ValueError: an entry is missing or invalid.
        """
        if lacking := [key for key in ("aslip", "interface", "joint_names") if key not in metadata]:
            raise ValueError(f"its metadata lack {lacking}")
        about, interface = json.loads(metadata["aslip"]), json.loads(metadata["interface"])
        return cls(dict(metadata), about, **interface)

    @property
    def observation(self) -> list[str]:
        """Names of the observation's entries, in order."""
        return self.metadata["observation_names"].split(",")

    def numbers(self, key: str) -> list[float]:
        """Numbers of a metadata entry, one per motor."""
        return [float(text) for text in self.metadata[key].split(",")]

    def golden_trace(self) -> dict[str, np.ndarray]:
        """Arrays of the golden trace.

        Raises:
            Exception: the entry is missing or damaged.
        """
        data = base64.b64decode(self.metadata.get("golden_trace", ""), validate=True)
        arrays = read_zip(io.BytesIO(data))
        return {name.removesuffix(".npy"): from_npy(array) for name, array in arrays.items()}

    def difference(self, robot: Robot) -> str | None:
        """First difference between the contract and a robot, in words; None without any."""
        version = self.about.get("contract")
        if version != CONTRACT_VERSION:
            return f"its contract has version {version}, this package reads {CONTRACT_VERSION}"
        has = {
            **self.about["robot"],
            "motor_names": self.metadata["joint_names"].split(","),
            "stiffness": self.numbers("joint_stiffness"),
            "damping": self.numbers("joint_damping"),
        }
        wanted = {**describe_robot(robot), **_lists(robot, "motor_names", "stiffness", "damping")}
        for name, value in wanted.items():
            if has.get(name) != value or list(_keys(has[name])) != list(_keys(value)):
                return f"{name} is {has.get(name)} in the file and {value} of this robot"
        return None


def describe_robot(robot: Robot) -> dict[str, Any]:
    """Fields of a robot in the entry `aslip`, as JSON types; mjlab has keys for the others."""
    return {
        "name": robot.name,
        "model_sha256": hashlib.sha256(robot.mjcf.read_bytes()).hexdigest(),
        **_lists(robot, *_ROBOT_FIELDS),
    }


def _lists(robot: Robot, *names: str) -> dict[str, Any]:
    """Fields of a robot as JSON types."""
    return {name: _plain(getattr(robot, name)) for name in names}


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists."""
    return np.asarray(value).tolist() if isinstance(value, np.ndarray | tuple) else value


def _keys(value: Any) -> Sequence[str]:
    """Keys of a mapping in order; order matters in packets."""
    return list(value) if isinstance(value, Mapping) else []


def csv(values: Iterable[float | str]) -> str:
    """Comma-separated values, numbers in full precision."""
    return ",".join(v if isinstance(v, str) else repr(float(v)) for v in values)


def trace_text(arrays: Mapping[str, np.ndarray]) -> str:
    """Encode a golden trace as text for the metadata."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    return base64.b64encode(buffer.getvalue()).decode()


# ------------------------------------------------------------------------- files


def seal(model: bytes) -> bytes:
    """Append the SHA-256 of a serialised ONNX model as the last entry of its metadata."""
    return model + _SEAL + hashlib.sha256(model).hexdigest().encode()


def read_sealed(path: Path) -> bytes:
    """Read the bytes of an exported policy, and check that they are complete and unaltered.

    Raises:
        FileDamagedError: the file is truncated, altered, no exported policy, or points to another
            file.
    """
    data = path.read_bytes()
    model, end = data[:-_SEAL_SIZE], data[-_SEAL_SIZE:]
    if not end.startswith(_SEAL):
        raise damaged(path, "it does not end with its SHA-256: truncated, or no exported policy")
    if end != seal(model)[-_SEAL_SIZE:]:
        raise damaged(path, "wrong SHA-256: altered since its export")
    if external_data(model):
        raise damaged(path, "it points to data in another file")
    return data


def external_data(model: bytes) -> bool:
    """Check whether a serialised model may point to data in another file."""
    return _EXTERNAL in model


def damaged(path: Path, why: str) -> FileDamagedError:
    """Build the error of a damaged file."""
    return FileDamagedError(
        f"{str(path)!r} is not an intact exported policy ({why}); export it again with"
        " python -m aslip.control.export"
    )


@contextmanager
def explained(path: Path, what: str = "") -> Iterator[None]:
    """Turn every error that the content of a file causes into a `FileDamagedError`.

    Errors of the machine are raised as they are.

    Args:
        path: the file.
        what: beginning of the reason.
    """
    try:
        yield
    except Exception as error:  # onnxruntime's errors have no common class, those of content many
        if isinstance(error, FileDamagedError) or machine_failed(error):
            raise
        first = (str(error).splitlines() or [""])[0]
        own = type(error) is ValueError or isinstance(error, AslipError)
        kind = "" if own else f"{type(error).__name__}: "
        raise damaged(path, f"{what}{kind}{first}") from error


def wrong(path: Path, difference: str) -> ConfigurationError:
    """Build the error of a policy that fits another robot, library or version of the package."""
    return ConfigurationError(f"the exported policy {str(path)!r} does not fit: {difference}")
