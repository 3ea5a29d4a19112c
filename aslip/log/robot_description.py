"""The robot as URDF for viewers: primitive shapes only, every body hung from the world by itself.

Viewers place links by the transforms of `/tf`; joints and loops of the mechanism are not in here.
What URDF has no shape for is approximated: a capsule is a cylinder and two spheres, an ellipsoid
the sphere of equal volume.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from aslip.log.messages import ROM_FRAMES, WORLD_FRAME
from aslip.robot.model import APPEARANCE_GROUP, geom_color
from aslip.show.ghost import BODY_COLOR, BODY_RADIUS, LEG_COLORS

# feet larger than the model's, since nothing is drawn between them and the body
_ROM_RADII = (BODY_RADIUS, 0.03, 0.03)
_ROM_COLORS = (BODY_COLOR, *LEG_COLORS.values())
_ROM_OPACITY = 0.7


def robot_description(model: mujoco.MjModel, poses: np.ndarray) -> str:
    """URDF of the robot and of the reduced-order model's body and feet.

    Args:
        model: the robot with what is looked at, `aslip.robot.model.load_model()`.
        poses: (b, 7) where the model's bodies but the world, then `ROM_FRAMES`, are at the log's
            first instant: positions [m] and quaternions (xyzw). Viewers that take a joint's origin
            for a transform of its own show it beside the first one of `/tf`.
    """
    robot = ET.Element("robot", name="cassie")
    ET.SubElement(robot, "link", name=WORLD_FRAME)
    for body in range(1, model.nbody):
        link = _link(robot, model.body(body).name, poses[body - 1])
        for geom in range(model.body_geomadr[body], _end(model, body)):
            if model.geom_group[geom] == APPEARANCE_GROUP:
                _geom(link, model, geom)
    frames = zip(ROM_FRAMES, poses[model.nbody - 1 :], _ROM_RADII, _ROM_COLORS, strict=True)
    for name, pose, radius, color in frames:
        rgba = _text(*color[:3], _ROM_OPACITY)
        link = _link(robot, name, pose)
        shape = _visual(link, name, rgba, np.zeros(3), np.eye(3))
        ET.SubElement(shape, "sphere", radius=_text(radius))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True)


def _end(model: mujoco.MjModel, body: int) -> int:
    return model.body_geomadr[body] + model.body_geomnum[body]


def _link(robot: ET.Element, name: str, pose: np.ndarray) -> ET.Element:
    """A link hung from the world by a floating joint at a pose (7)."""
    joint = ET.SubElement(robot, "joint", name=f"{name}_pose", type="floating")
    ET.SubElement(joint, "parent", link=WORLD_FRAME)
    ET.SubElement(joint, "child", link=name)
    _origin(joint, pose[:3], Rotation.from_quat(pose[3:]).as_matrix())
    return ET.SubElement(robot, "link", name=name)


def _geom(link: ET.Element, model: mujoco.MjModel, geom: int) -> None:
    """Add a geom's shapes."""
    kinds = mujoco.mjtGeom
    kind, size, position = model.geom_type[geom], model.geom_size[geom], model.geom_pos[geom]
    rotation = Rotation.from_quat(model.geom_quat[geom], scalar_first=True).as_matrix()
    name, rgba = f"{link.get('name')}_{geom}", _text(*geom_color(model, geom))
    if kind == kinds.mjGEOM_BOX:
        ET.SubElement(_visual(link, name, rgba, position, rotation), "box", size=_text(*2 * size))
    elif kind == kinds.mjGEOM_SPHERE or kind == kinds.mjGEOM_ELLIPSOID:
        radius = size[0] if kind == kinds.mjGEOM_SPHERE else float(np.prod(size)) ** (1 / 3)
        shape = _visual(link, name, rgba, position, rotation)
        ET.SubElement(shape, "sphere", radius=_text(radius))
    elif kind == kinds.mjGEOM_CAPSULE or kind == kinds.mjGEOM_CYLINDER:
        radius, half = size[:2]
        shape = _visual(link, name, rgba, position, rotation)
        ET.SubElement(shape, "cylinder", radius=_text(radius), length=_text(2 * half))
        if kind == kinds.mjGEOM_CAPSULE:
            for i, end in enumerate((-half, half)):
                center = position + end * rotation[:, 2]
                shape = _visual(link, f"{name}_{i}", rgba, center, rotation)
                ET.SubElement(shape, "sphere", radius=_text(radius))
    else:
        raise ValueError(f"geom {geom} of {link.get('name')!r} is no primitive shape: type {kind}")


def _visual(
    link: ET.Element, name: str, rgba: str, position: np.ndarray, rotation: np.ndarray
) -> ET.Element:
    """A visual at a pose; returns the element its shape goes into."""
    visual = ET.SubElement(link, "visual")
    _origin(visual, position, rotation)
    geometry = ET.SubElement(visual, "geometry")
    material = ET.SubElement(visual, "material", name=name)
    ET.SubElement(material, "color", rgba=rgba)
    return geometry


def _origin(element: ET.Element, position: np.ndarray, rotation: np.ndarray) -> None:
    with warnings.catch_warnings():
        # at a pitch of 90 degrees there are many answers, of which any will do
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(rotation).as_euler("xyz")
    ET.SubElement(element, "origin", xyz=_text(*position), rpy=_text(*angles))


def _text(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)
