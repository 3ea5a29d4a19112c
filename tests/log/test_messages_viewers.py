"""rosbags decodes a log, and the shipped layouts plot topics and fields of a log."""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from tensordict import TensorDict

from aslip.base.assets import asset_path
from aslip.log import Recording
from aslip.robot import CASSIE
from tests.log.helpers import CURVES

Walk = tuple[Path, list[TensorDict]]


# --------------------------------------------------------------------- rosbags


@pytest.fixture(scope="module")
def rosbags() -> ModuleType:
    """Module that decodes ROS 2 messages."""
    return pytest.importorskip("rosbags.typesys")


def _schemas(path: Path) -> dict[str, str]:
    """Definitions of a log's types by name."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {schema.name: schema.data.decode() for schema in summary.schemas.values()}


def _field(message: Any, name: str) -> Any:
    """Entry by its dotted name; in a list of messages, that of each."""
    for part in name.split("."):
        if isinstance(message, list):
            message = [getattr(item, part) for item in message]
        else:
            message = getattr(message, part)
    return message


def test_rosbags_decodes_every_topic_to_the_same_numbers(walk: Walk, recording: Recording) -> None:
    bags = pytest.importorskip("rosbags.highlevel")
    decoded: dict[str, list[Any]] = {}
    with bags.AnyReader([walk[0]]) as reader:  # refuses files without the profile of ROS 2
        store = reader.typestore
        for connection, _, data in reader.messages():
            value = reader.deserialize(data, connection.msgtype)
            # the length is exactly that of the type
            assert len(store.serialize_cdr(value, connection.msgtype)) == len(data)
            decoded.setdefault(connection.topic, []).append(value)
    assert decoded.keys() == recording.series.keys()
    for topic, rows in decoded.items():
        series = recording[topic]
        fields = {name for name, _ in store.fielddefs[rows[0].__msgtype__][1]}
        assert {name.split(".")[0] for name in series.columns} == fields
        for name, column in series.columns.items():
            theirs = np.array([_field(row, name) for row in rows])
            np.testing.assert_array_equal(theirs, column, err_msg=f"{topic} {name}")


def test_standard_message_types_match_ros(walk: Walk, rosbags: ModuleType) -> None:
    ros = rosbags.get_typestore(rosbags.Stores.LATEST).fielddefs
    schemas = _schemas(walk[0])
    standard = {name for name in schemas if not name.startswith("aslip_msgs/")}
    assert standard == {
        "std_msgs/msg/String",
        "tf2_msgs/msg/TFMessage",
        "sensor_msgs/msg/JointState",
        "rcl_interfaces/msg/Log",
    }
    for name in standard:
        for part, (_, fields) in rosbags.get_types_from_msg(schemas[name], name).items():
            assert fields == ros[part][1], part


# --------------------------------------------------------------------- layouts


def test_foxglove_layout_plots_logged_fields(recording: Recording) -> None:
    layout = json.loads(asset_path("viewers/foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    curves, joints = set(), []
    for panel in panels.values():
        for path in panel.get("paths", []):
            match = re.fullmatch(r"(/\w+)\.(\w+)(?:\[(\d+)\])?", path["value"])
            assert match is not None, path
            topic, field, index = match.groups()
            joint = None if index is None else int(index)
            assert recording[topic][field].ndim == (1 if joint is None else 2)
            if joint is None:
                curves.add((topic, field))
            else:
                assert path["label"] == recording[topic]["name"][0, joint]
                joints.append((topic, field, path["label"]))
    assert curves == CURVES
    assert joints == [("/joint_states", "position", name) for name in CASSIE.motor_names]
    assert panels["RosOut!log"]["topicToRender"] == "/log"
    assert len(recording["/log"]) > 0
    # every panel has a place, and every place a panel
    assert sorted(_leaves(layout["layout"])) == sorted(panels)


def _leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert 0 < node["splitPercentage"] < 100
        yield from _leaves(node["first"])
        yield from _leaves(node["second"])


def test_plotjuggler_layout_plots_logged_fields(recording: Recording) -> None:
    series = {
        f"{topic}/{field}": (topic, field)
        for topic, content in recording.series.items()
        if topic != "/joint_states"
        for field in content.columns
    }
    joints = {
        f"/joint_states/{name}/{field}": (name, field)
        for name in recording["/joint_states"]["name"][0]
        for field in ("position", "velocity", "effort")
    }
    root = ET.parse(asset_path("viewers/plotjuggler.xml")).getroot()
    names = [str(curve.get("name")) for curve in root.iter("curve")]
    assert len(names) == len(set(names))
    assert {series[name] for name in names if name not in joints} == CURVES
    assert {joints[name] for name in names if name in joints} == {
        (motor, field)
        for motor in CASSIE.motor_names
        for field in ("position", "velocity", "effort")
    }
