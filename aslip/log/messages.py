"""Topics of a log, their ROS 2 message types, and the order of numbers in them.

| topic | rate | content |
|---|---|---|
| `/robot_description` | once | URDF of the bodies, primitive shapes only |
| `/tf` | 33 Hz | world to each body, and to the reduced-order model's body and feet |
| `/joint_states` | 33 Hz or 2 kHz | `LOGGED_JOINTS`: position, velocity, effort [rad, rad/s, N m] |
| `/truth`, `/estimate`, `/odometry`, `/reference` | 33 Hz | by the tensordict's names |
| `/true_odometry` | 33 Hz | the truth in the heading frame, and its `heading` [rad] |
| | | in all directions, also `origin` of that frame and `path_error`, as in `/odometry` |
| `/observation` | 33 Hz | observation that the policy acts on next |
| `/sensors` | 33 Hz | packets with noise; an array per number, oldest first |
| `/step` | 33 Hz | `phase`, `command`, `action`, `motor_target`, `push`: inputs of the step |
| | | in all directions also `filtered_command`; of robots that stand also `stand` and `mode` |
| | | `reward`, terms, `ground_force`, `terminated`, `truncated`, `done`: its outcome |
| `/plan` | 33 Hz | of a planner: `aslip.transforms.planned.PLAN_SIZES`, without its state |
| `/stones` | 1 Hz, changes | stones by the columns of `aslip.sim.course.STONE`, NaN where is none |
| `/touchdown` | a footstep | side (0 left, 1 right), actual and planned place [m] |
| `/state` | 1 Hz, resets | physics state and sensors' memory, for replays |
| `/dynamics` | 1 Hz, changes | parameters of `aslip.sim.DYNAMICS`, and motors' `memory` |
| `/log` | events | beginning and end of episodes |

Messages are plain ROS 2 types or flat lists of named numbers, so that viewers show them without
set-up and plots can name every curve. A message describes the state at its time stamp, with two
exceptions: `/step` and `/sensors` describe the policy step that ends then, and `/touchdown` a
contact within that step, up to 30 ms earlier. Units are SI and radians; frames are those of the
tensordict's entries (see `aslip.sim.true_state`). Quaternions are xyzw in `/tf`, as usual in ROS;
elsewhere each component has a name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Final

from mcap_ros2.writer import serialize_dynamic  # pyright: ignore[reportPrivateImportUsage]

from aslip.estimation import FAULTS
from aslip.robot import CASSIE, SIDES

FORMAT: Final = "2"
"""Version of this format. Readers refuse other versions, and name the version and commit of aslip
that can read and replay the log. Format 1 lacked the hash of its metadata and the topics
`/observation`, `/sensors`, `/odometry` and `/dynamics`, and had the whole model in `model.json`."""

LOGGED_JOINTS: Final = (
    *CASSIE.motor_names,
    *(f"{side}_{joint}" for side in SIDES for joint in ("shin", "tarsus", "heel_spring")),
)
"""Joints of `/joint_states`: the motors, then the passive joints of the legs."""

ROM_FRAMES: Final = ("rom_body", "rom_left_foot", "rom_right_foot")
"""Frames of the reduced-order model in `/tf`, children of the world like the robot's bodies."""

WORLD_FRAME: Final = "world"

MEMORY: Final = "memory"
"""Column of `/dynamics`: number of torque commands in a motor's memory, one per physics step."""

_SEPARATOR = "\n" + "=" * 80 + "\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"


@dataclass(frozen=True)
class MessageType:
    """A ROS 2 message type."""

    name: str
    """Package, "msg" and type, separated by slashes."""
    text: str
    """Definition, followed by those of the types it uses."""

    @cached_property
    def _encode(self) -> Any:
        return serialize_dynamic(self.name, self.text)[self.name]

    def encode(self, message: Mapping[str, Any]) -> bytes:
        """Encode a message of nested dicts and lists as CDR."""
        return bytes(self._encode(_namespace(message)))


STRING = MessageType("std_msgs/msg/String", "string data")

TRANSFORMS = MessageType(
    "tf2_msgs/msg/TFMessage",
    _SEPARATOR.join(
        [
            "geometry_msgs/TransformStamped[] transforms",
            "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
            "geometry_msgs/Transform transform",
            "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\n"
            "geometry_msgs/Quaternion rotation",
            "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
            "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
            _HEADER,
            _TIME,
        ]
    ),
)

JOINT_STATE = MessageType(
    "sensor_msgs/msg/JointState",
    _SEPARATOR.join(
        [
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
            "float64[] effort",
            _HEADER,
            _TIME,
        ]
    ),
)

LOG = MessageType(
    "rcl_interfaces/msg/Log",
    _SEPARATOR.join(
        [
            "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n"
            "string function\nuint32 line",
            _TIME,
        ]
    ),
)
INFO, WARN = 20, 30
"""Levels of `LOG`."""

STATE = MessageType(
    "aslip_msgs/msg/State",
    "float64 episode\nfloat64 step\nfloat64[] integration\nfloat64[] sensors",
)

TOUCHDOWN = MessageType(
    "aslip_msgs/msg/Touchdown",
    "uint8 side\nfloat64 x\nfloat64 y\nfloat64 x_planned\nfloat64 y_planned\nfloat64 speed",
)


# names of the numbers of entries that are no vectors; one number has the entry's name alone
_PARTS: Final = {
    "command": ("forward", "sideways", "yaw_rate"),
    "filtered_command": ("forward", "sideways", "yaw_rate"),
    "path_error": ("forward", "sideways"),
}


def component_names(name: str, size: int) -> list[str]:
    """Names of the numbers of an entry: axes, quaternion components, motors, joints, feet.

    Args:
        name: name of the entry, such as "pelvis_position".
        size: number of numbers.
    """
    if size == 1:
        return [name]
    if name in _PARTS:
        return [f"{name}_{part}" for part in _PARTS[name][:size]]
    if name == "later_footholds":
        return [f"{name}_{i}_{axis}" for i in range(size // 3) for axis in "xyz"]
    if size == len(CASSIE.motor_names):
        return [f"{name}_{motor}" for motor in CASSIE.motor_names]
    if size == len(CASSIE.joint_names) and "joint" in name:
        return [f"{name}_{joint}" for joint in CASSIE.joint_names]
    if size == 2 * 3:
        return [f"{name}_{side}_{axis}" for side in SIDES for axis in "xyz"]
    if size == len(SIDES):
        return [f"{name}_{side}" for side in SIDES]
    if name == "fault":
        return [f"{name}_{fault}" for fault in FAULTS]
    axes = {3: "xyz", 4: "wxyz"}.get(size)
    return [f"{name}_{part}" for part in axes or range(size)]


def note(time_ns: int, text: str, level: int = INFO) -> dict[str, Any]:
    """Message of `LOG` with a line of text."""
    return {
        "stamp": stamp(time_ns), "level": level, "name": "aslip",
        "msg": text, "file": "", "function": "", "line": 0,
    }  # fmt: skip


def stamp(time_ns: int) -> dict[str, int]:
    """ROS time of a time in nanoseconds."""
    seconds, nanoseconds = divmod(time_ns, 10**9)
    return {"sec": seconds, "nanosec": nanoseconds}


def _namespace(value: Any) -> Any:
    if isinstance(value, Mapping):
        return SimpleNamespace(**{key: _namespace(item) for key, item in value.items()})
    if isinstance(value, list | tuple):
        return [_namespace(item) for item in value]
    return value
