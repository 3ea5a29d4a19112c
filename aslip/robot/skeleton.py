"""Numbers of a robot's MJCF as MuJoCo compiles them, by name and readable without MuJoCo.

`assets/cassie.json` holds those of `assets/cassie.xml`; `python -m aslip.robot` rewrites it.
Quaternions are wxyz; positions [m] and orientations are relative to the parent body.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

Vector = tuple[float, ...]


class Body(NamedTuple):
    """Rigid body."""

    index: int
    parent: str
    position: Vector
    quaternion: Vector
    mass: float
    """[kg]."""
    centre: Vector
    """Centre of mass [m]."""
    axes: Vector
    """Orientation of the principal axes."""
    inertia: Vector
    """Moments of inertia about them [kg m^2]."""


class Joint(NamedTuple):
    """Joint, with its places in `qpos` and `qvel`."""

    body: str
    kind: str
    """`free`, `ball`, `slide` or `hinge`."""
    qpos: int
    qvel: int
    zero: float
    """Position at the configuration in which the MJCF defines the bodies [rad]."""
    stiffness: float
    """Stiffness of its spring [N m/rad]."""
    armature: float
    """Reflected inertia of its motor [kg m^2]."""
    range: Vector
    """Least and greatest position [rad, m]; empty without limits."""


class Site(NamedTuple):
    """Site on a body."""

    index: int
    body: str
    position: Vector
    quaternion: Vector


class Geom(NamedTuple):
    """Named geom; a capsule's size is its radius and half its length [m]."""

    body: str
    position: Vector
    quaternion: Vector
    size: Vector


class Connection(NamedTuple):
    """Point of one body tied to a point of another, which closes a loop."""

    first: str
    second: str
    first_point: Vector
    second_point: Vector


class Sensor(NamedTuple):
    """Place of a sensor's numbers in `sensordata`."""

    start: int
    size: int


@dataclass(frozen=True)
class Skeleton:
    """Parts of a compiled model, by name."""

    num_qpos: int
    num_qvel: int
    bodies: Mapping[str, Body]
    joints: Mapping[str, Joint]
    sites: Mapping[str, Site]
    geoms: Mapping[str, Geom]
    connections: Mapping[str, Connection]
    sensors: Mapping[str, Sensor]
    standing: Vector
    """`qpos` of the keyframe `standing`."""


_PARTS = {
    "bodies": Body,
    "joints": Joint,
    "sites": Site,
    "geoms": Geom,
    "connections": Connection,
    "sensors": Sensor,
}


def write_skeleton(skeleton: Skeleton, mjcf: Path, path: Path) -> None:
    """Write a skeleton and the hash of the MJCF that it was compiled from, as JSON."""
    entries = {"mjcf": _digest(mjcf), **asdict(skeleton)}
    lines = [f"{json.dumps(name)}: {_text(value)}" for name, value in entries.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def read_skeleton(mjcf: Path, path: Path) -> Skeleton | None:
    """Skeleton of an MJCF from its JSON file; None if the file is missing or outdated."""
    if not path.is_file():
        return None
    entries = json.loads(path.read_text(encoding="utf-8"))
    if entries.pop("mjcf") != _digest(mjcf):
        return None
    parts = {
        key: {name: kind(*map(_fixed, row)) for name, row in entries[key].items()}
        for key, kind in _PARTS.items()
    }
    rest = {key: _fixed(value) for key, value in entries.items() if key not in parts}
    return Skeleton(**parts, **rest)


def _digest(path: Path) -> str:
    """Hash of an MJCF without its comments."""
    text = ElementTree.canonicalize(from_file=str(path), strip_text=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _text(value: object) -> str:
    """JSON with one line per part."""
    if not isinstance(value, Mapping):
        return json.dumps(value)
    rows = [f" {json.dumps(name)}: {json.dumps(row)}" for name, row in value.items()]
    return "{\n" + ",\n".join(rows) + "\n}"


def _fixed(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
