"""Robot for viewers: poses of its bodies, states of its joints, and its shapes as a URDF."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES, WORLD_FRAME
from aslip.robot import CASSIE
from aslip.robot.model import APPEARANCE_GROUP, geom_color
from aslip.robot.rotation import quaternion_to_matrix
from aslip.show.ghost import BODY_COLOR, BODY_RADIUS, LEG_COLORS


class LoggedKinematics:
    """Poses of all bodies and states of the logged joints, from `qpos`, `qvel` and torques.

    Args:
        model: compiled model of the robot.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._xpos, self._xquat = self._data.xpos[1:], self._data.xquat[1:]
        self.bodies = [model.body(i).name for i in range(1, model.nbody)]
        joints = [model.joint(name) for name in LOGGED_JOINTS]
        passive = joints[model.nu :]
        qpos = np.array([joint.qposadr[0] for joint in joints])
        qvel = np.array([joint.dofadr[0] for joint in joints])
        motors = np.arange(model.nu)
        # columns of `SimulatedEnv.watched`
        self._columns = np.concatenate([qpos, model.nq + qvel, model.nq + model.nv + motors])
        self._rest = model.qpos_spring[qpos[len(motors) :]]
        self._springs = np.array([[joint.stiffness[0], joint.damping[0]] for joint in passive]).T
        self.scale(1.0, 1.0)

    def scale(self, stiffness: float, damping: float) -> None:
        """Multiply stiffness and damping of the model's springs by factors."""
        self._stiffness, self._damping = self._springs * [[stiffness], [damping]]

    def poses(self, qpos: np.ndarray, out: np.ndarray) -> None:
        """Write positions [m] and quaternions (xyzw) of all bodies except the world to (b, 7)."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        out[:, :3], out[:, 3:6], out[:, 6] = self._xpos, self._xquat[:, 1:], self._xquat[:, 0]

    def joints(self, rows: np.ndarray) -> np.ndarray:
        """Positions, velocities and efforts of `LOGGED_JOINTS`, from `qpos`, `qvel` and torques.

        Args:
            rows: (*b, k), each `qpos`, `qvel` and motor torques as in `SimulatedEnv.watched`.

        Returns:
            (*b, 3 j). The effort of a motor is its torque at the joint, that of a spring includes
            its damper [N m].
        """
        count, motors = len(LOGGED_JOINTS), self._model.nu
        values = rows[..., self._columns]
        angle, velocity = values[..., motors:count], values[..., count + motors : 2 * count]
        effort = self._stiffness * (self._rest - angle) - self._damping * velocity
        return np.concatenate([values, effort], axis=-1)


# feet are larger than in pictures, because no legs are drawn
_ROM_RADII = (BODY_RADIUS, 0.03, 0.03)
_ROM_COLORS = (BODY_COLOR, *LEG_COLORS.values())
_ROM_OPACITY = 0.7


def robot_description(model: mujoco.MjModel, poses: np.ndarray) -> str:
    """URDF of the robot and of the reduced-order model's body and feet.

    Args:
        model: robot with its visible geoms, `aslip.robot.model.load_model()`.
        poses: (b, 7) positions [m] and quaternions (xyzw) of the model's bodies without the world,
            then of `ROM_FRAMES`, at the first instant of the log. They are the origins of the
            joints, so that viewers that use these as transforms agree with the first `/tf`.
    """
    robot = ET.Element("robot", name=CASSIE.name)
    ET.SubElement(robot, "link", name=WORLD_FRAME)
    for body in range(1, model.nbody):
        link = _link(robot, model.body(body).name, poses[body - 1])
        for geom in range(model.body_geomadr[body], _end(model, body)):
            if model.geom_group[geom] == APPEARANCE_GROUP:
                _geom(link, model, geom)
    frames = zip(ROM_FRAMES, poses[model.nbody - 1 :], _ROM_RADII, _ROM_COLORS, strict=True)
    for frame, pose, radius, color in frames:
        rgba = _text(*color[:3], _ROM_OPACITY)
        link = _link(robot, frame, pose)
        shape = _visual(link, frame, rgba, np.zeros(3), np.eye(3))
        ET.SubElement(shape, "sphere", radius=_text(radius))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True)


def _end(model: mujoco.MjModel, body: int) -> int:
    return model.body_geomadr[body] + model.body_geomnum[body]


def _link(robot: ET.Element, name: str, pose: np.ndarray) -> ET.Element:
    """Add a link on a floating joint from the world, at a pose (7,)."""
    joint = ET.SubElement(robot, "joint", name=f"{name}_pose", type="floating")
    ET.SubElement(joint, "parent", link=WORLD_FRAME)
    ET.SubElement(joint, "child", link=name)
    _origin(joint, pose[:3], quaternion_to_matrix(np.roll(pose[3:], 1)))
    return ET.SubElement(robot, "link", name=name)


def _geom(link: ET.Element, model: mujoco.MjModel, geom: int) -> None:
    """Add the visual shapes of a geom."""
    kinds = mujoco.mjtGeom
    kind, size, position = model.geom_type[geom], model.geom_size[geom], model.geom_pos[geom]
    rotation = quaternion_to_matrix(model.geom_quat[geom])
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
        raise ValueError(
            f"geom {geom} of {link.get('name')!r} is not a primitive shape: type {kind}"
        )


def _visual(
    link: ET.Element, name: str, rgba: str, position: np.ndarray, rotation: np.ndarray
) -> ET.Element:
    """Add a visual at a pose; return the element of its shape."""
    visual = ET.SubElement(link, "visual")
    _origin(visual, position, rotation)
    geometry = ET.SubElement(visual, "geometry")
    material = ET.SubElement(visual, "material", name=name)
    ET.SubElement(material, "color", rgba=rgba)
    return geometry


def _origin(element: ET.Element, position: np.ndarray, rotation: np.ndarray) -> None:
    from scipy.spatial.transform import Rotation  # slow to import

    with warnings.catch_warnings():
        # at a pitch of 90 degrees, roll and yaw are not unique; any solution is valid
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(rotation).as_euler("xyz")
    ET.SubElement(element, "origin", xyz=_text(*position), rpy=_text(*angles))


def _text(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)
