"""The MJCF of the robot as a Pinocchio model, with what Pinocchio's reader gets wrong or omits.

Pinocchio 4.1 measures joints as MuJoCo does, from their `ref`, yet subtracts the `ref` from their
limits; and its neutral configuration is all zeros, not the pose that the file draws. In the drawn
pose every joint is at its `ref`, and the loops are closed.
"""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

DRAWN = "drawn"
"""Name of the drawn pose in the model's `referenceConfigurations`."""


def read_mjcf(path: Path) -> tuple[pin.Model, Sequence[pin.PointAnchorConstraintModel]]:
    """Model and loop closures of an MJCF file.

    The model's joint limits are those of the file, and its drawn pose is
    `model.referenceConfigurations[DRAWN]`.
    """
    model, loops, _ = pin.buildModelAndConstraintsFromMJCF(str(path))
    drawn = pin.neutral(model)
    for name, reference in joint_references(path).items():
        slot = model.idx_qs[model.getJointId(name)]
        drawn[slot] = reference
        model.lowerPositionLimit[slot] += reference
        model.upperPositionLimit[slot] += reference
    model.referenceConfigurations[DRAWN] = drawn
    return model, loops


def joint_references(path: Path) -> dict[str, float]:
    """`ref` of every hinge that has one [rad], from its own tag or else from its default class."""
    root = ElementTree.parse(path).getroot()
    compiler = root.find("compiler")
    radians = compiler is not None and compiler.get("angle") == "radian"
    classes: dict[str | None, str | None] = {}
    for default in root.findall("default"):
        _collect(default, None, classes)
    found = {
        joint.attrib["name"]: joint.get("ref", classes.get(joint.get("class")))
        for joint in root.iterfind("worldbody//joint[@name]")
    }
    scale = 1.0 if radians else math.pi / 180
    return {name: scale * float(value) for name, value in found.items() if value is not None}


def _collect(
    default: ElementTree.Element, inherited: str | None, classes: dict[str | None, str | None]
) -> None:
    """Note the `ref` of a default class and, in turn, of the classes nested in it."""
    joint = default.find("joint")
    reference = inherited if joint is None else joint.get("ref", inherited)
    classes[default.get("class")] = reference
    for nested in default.findall("default"):
        _collect(nested, reference, classes)
