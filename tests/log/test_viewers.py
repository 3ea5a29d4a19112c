"""Other people's readers understand a log, and the layouts that ship name what is in it."""

from __future__ import annotations

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

from aslip.files.assets import asset_path
from aslip.log import Recording
from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES
from aslip.robot import CASSIE
from aslip.transforms.rewards import PAPER_WEIGHTS

Walk = tuple[Path, list[TensorDict]]

# what every layout plots, by topic and field
VELOCITIES = {
    ("/step", "command"),
    ("/reference", "body_velocity_x"),
    ("/truth", "pelvis_velocity_x"),
    ("/estimate", "velocity_x"),
}
CURVES = {
    *VELOCITIES,
    *(("/step", f"term_{name}") for name in PAPER_WEIGHTS),
    *(("/step", f"ground_force_{side}_z") for side in ("left", "right")),
}

# ----------------------------------------------------------------------- Rerun


@pytest.fixture(scope="module")
def chunk() -> ModuleType:
    """Rerun's readers of files."""
    return pytest.importorskip("rerun.chunk")


class RerunLog:
    """What Rerun makes of a file: columns of entities, in the order of their times."""

    def __init__(self, chunks: list[Any]) -> None:
        self._batches: dict[str, list[tuple[bool, Any]]] = {}
        for part in chunks:
            entity = self._batches.setdefault(str(part.entity_path), [])
            entity.append((part.is_static, part.to_record_batch()))
        self.entities = set(self._batches)

    def column(self, entity: str, component: str, static: bool = False) -> list[Any]:
        """A component's rows, each a list of instances."""
        return [
            row
            for is_static, batch in self._batches.get(entity, [])
            if is_static == static and component in batch.schema.names
            for row in batch.column(component).to_pylist()
        ]

    def arrays(self, entity: str, component: str) -> list[Any]:
        """The same that changes with time, as Arrow arrays."""
        return [
            batch.column(component)
            for is_static, batch in self._batches.get(entity, [])
            if not is_static and component in batch.schema.names
        ]

    def time(self, entity: str, component: str) -> np.ndarray:
        """(m,) times of a component's rows [s]."""
        columns = [
            batch.column("message_log_time").cast("int64").to_numpy()
            for is_static, batch in self._batches[entity]
            if not is_static and component in batch.schema.names
        ]
        return np.concatenate(columns) / 1e9


@pytest.fixture(scope="module")
def rerun_log(walk: Walk, chunk: ModuleType) -> RerunLog:
    """The log as Rerun reads it."""
    return RerunLog(chunk.McapReader(walk[0]).stream().to_chunks())


def test_rerun_draws_every_shape_of_the_robot(rerun_log: RerunLog, recording: Recording) -> None:
    robot = ET.fromstring(str(recording["/robot_description"]["data"][0]))
    drawn = {
        "box": "Boxes3D:half_sizes",
        "cylinder": "Cylinders3D:lengths",
        "sphere": "Ellipsoids3D:half_sizes",
    }
    count = 0
    for link in robot.iter("link"):
        for i, visual in enumerate(link.findall("visual")):
            entity = f"/cassie/visual_geometries/{link.get('name')}/visual_{i}"
            geometry = visual.find("geometry")
            assert geometry is not None
            (size,) = rerun_log.column(entity, drawn[geometry[0].tag], static=True)
            assert np.min(size) > 0
            # hung from the frame of its link, which is what moves it
            (frame,) = rerun_log.column(entity, "CoordinateFrame:frame", static=True)
            assert frame == [link.get("name")]
            count += 1
    assert count > 100
    shapes = {e for e in rerun_log.entities if e.startswith("/cassie/visual_geometries/")}
    assert len({e for e in shapes if "/visual_" in e}) == count
    assert rerun_log.column("/cassie", "CoordinateFrame:frame", static=True) == [["world"]]


def test_rerun_reads_the_transform_of_every_link(rerun_log: RerunLog, recording: Recording) -> None:
    ours = recording["/tf"]
    frames = ours["transforms.child_frame_id"]
    shape = (len(ours), frames.shape[1])
    names = np.reshape(rerun_log.column("/tf", "Transform3D:child_frame"), shape)
    np.testing.assert_array_equal(names, frames)
    parents = rerun_log.column("/tf", "Transform3D:parent_frame")
    assert parents == [["world"]] * frames.size
    for component, part, axes in (
        ("translation", "translation", "xyz"),
        ("quaternion", "rotation", "xyzw"),
    ):
        theirs = np.reshape(rerun_log.column("/tf", f"Transform3D:{component}"), (*shape, -1))
        values = np.stack([ours[f"transforms.transform.{part}.{axis}"] for axis in axes], axis=-1)
        np.testing.assert_allclose(theirs, values, atol=1e-6)
    times = rerun_log.time("/tf", "Transform3D:child_frame").reshape(shape)
    np.testing.assert_array_equal(times, np.repeat(ours.time[:, None], shape[1], axis=1))
    # nothing else places a frame, or the two would disagree
    placed = {
        (entity, static)
        for entity in rerun_log.entities
        for static in (False, True)
        if rerun_log.column(entity, "Transform3D:child_frame", static)
    }
    assert placed == {("/tf", False)}
    links = {e.split("/")[3] for e in rerun_log.entities if "/visual_geometries/" in e}
    assert links <= set(frames[0])


def test_rerun_reads_names_and_states_of_joints(rerun_log: RerunLog, recording: Recording) -> None:
    ours = recording["/joint_states"]
    for field in ("position", "velocity", "effort"):
        entity = f"/joint_states/{field}"
        names = rerun_log.column(entity, "SeriesLines:names")
        assert names == [list(LOGGED_JOINTS)] * len(ours)
        np.testing.assert_array_equal(rerun_log.column(entity, "Scalars:scalars"), ours[field])
        np.testing.assert_array_equal(rerun_log.time(entity, "Scalars:scalars"), ours.time)


@pytest.mark.parametrize("topic", ["/truth", "/estimate", "/reference", "/step", "/touchdown"])
def test_rerun_reads_every_field_of_flat_topics(
    rerun_log: RerunLog, recording: Recording, topic: str
) -> None:
    rows = [row for (row,) in rerun_log.column(topic, _message(topic))]
    ours = recording[topic]
    assert list(rows[0]) == list(ours.columns)
    for name, column in ours.columns.items():
        np.testing.assert_array_equal([row[name] for row in rows], column, err_msg=name)
    np.testing.assert_array_equal(rerun_log.time(topic, _message(topic)), ours.time)


def test_rerun_shows_the_notes(rerun_log: RerunLog, recording: Recording) -> None:
    shown = [text for (text,) in rerun_log.column("/log", "TextLog:text")]
    ours = recording["/log"]
    assert len(shown) == len(ours)
    assert all(text in line for text, line in zip(ours["msg"], shown, strict=True))


def _message(topic: str) -> str:
    """The column in which Rerun keeps messages of a type of ours."""
    return f"aslip_msgs.msg.{topic.strip('/').title()}:message"


# --------------------------------------------------------------------- rosbags


@pytest.fixture(scope="module")
def rosbags() -> ModuleType:
    """A decoder of ROS 2 messages."""
    return pytest.importorskip("rosbags.typesys")


def _schemas(path: Path) -> dict[str, str]:
    """Definitions of a log's types by name."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {schema.name: schema.data.decode() for schema in summary.schemas.values()}


def _field(message: Any, name: str) -> Any:
    """An entry by its dotted name; of each, where there is a list of messages."""
    for part in name.split("."):
        if isinstance(message, list):
            message = [getattr(item, part) for item in message]
        else:
            message = getattr(message, part)
    return message


def test_rosbags_decodes_every_topic_to_the_same_numbers(
    walk: Walk, recording: Recording, rosbags: ModuleType
) -> None:
    store = rosbags.get_typestore(rosbags.Stores.EMPTY)
    for name, text in _schemas(walk[0]).items():
        # the types that all share are there once one has brought them
        types = rosbags.get_types_from_msg(text, name)
        store.register({key: kind for key, kind in types.items() if key not in store.fielddefs})
    decoded: dict[str, list[Any]] = {}
    with walk[0].open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            value = store.deserialize_cdr(message.data, schema.name)
            # not a byte more or less than the type says
            assert len(store.serialize_cdr(value, schema.name)) == len(message.data)
            decoded.setdefault(channel.topic, []).append(value)
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


def _numbers(recording: Recording, topic: str, field: str, joint: int | None = None) -> np.ndarray:
    """A field's numbers, of one joint where it has several."""
    column = recording[topic][field]
    return column if joint is None else column[:, joint]


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
            assert _numbers(recording, topic, field, joint).ndim == 1
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


def test_foxglove_layout_follows_the_robot(recording: Recording) -> None:
    layout = json.loads(asset_path("viewers/foxglove.json").read_text(encoding="utf-8"))
    scene = layout["configById"]["3D!robot"]
    frames = set(recording["/tf"]["transforms.child_frame_id"][0])
    assert scene["followTf"] == "pelvis"
    assert scene["followTf"] in frames
    assert {scene["fixedFrame"]} == set(recording["/tf"]["transforms.header.frame_id"].ravel())
    axes = {key.removeprefix("frame:"): value for key, value in scene["transforms"].items()}
    assert axes.keys() == {*frames, scene["fixedFrame"]}
    assert {name for name, settings in axes.items() if settings["visible"]} == set(ROM_FRAMES)
    assert {topic for topic, settings in scene["topics"].items() if settings["visible"]} == {
        "/robot_description"
    }
    assert len(recording["/robot_description"]) == 1


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
    tabs = [tab.get("tab_name") for tab in root.iter("Tab")]
    assert tabs == ["Velocity", "Reward", "Ground forces", "Motors"]
    # it reads as many sizes and children as a splitter says it has
    for splitter in root.iter("DockSplitter"):
        sizes = [float(size) for size in str(splitter.get("sizes")).split(";")]
        assert len(sizes) == len(splitter) == int(str(splitter.get("count")))
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)


class Blueprint:
    """A Rerun blueprint: what its views show, and what curves are made of."""

    def __init__(self, path: Path, chunk: ModuleType) -> None:
        reader = chunk.RrdReader(path)
        (store,) = reader.blueprints()
        self.application = store.application_id
        entries = {
            (str(part.entity_path), name): column.to_pylist()
            for part in reader.stream(store=store).to_chunks()
            for batch in [part.to_record_batch()]
            for name, column in zip(batch.schema.names, batch.columns, strict=True)
            if ":" in name  # the others are times
        }
        self.origins = {
            (entries[entity, "ViewBlueprint:class_identifier"][0][0], row[0][0])
            for (entity, name), row in entries.items()
            if name == "ViewBlueprint:space_origin"
        }
        self.curves: set[tuple[str, str, str]] = set()
        """Entity, component and selector."""
        for (entity, name), rows in entries.items():
            if name == "VisualizerInstruction:component_map":
                topic = entity.split("/overrides")[1].split("/visualizers/")[0]
                for mapping in rows[0]:
                    assert mapping["target"] == "Scalars:scalars"
                    self.curves.add((topic, mapping["source_component"], mapping["selector"]))
        shown = [rows[0] for (_, name), rows in entries.items() if name == "ViewContents:query"]
        self.contents = {path for paths in shown for path in paths}
        (self.followed,) = (
            rows[0][0]
            for (_, name), rows in entries.items()
            if name == "EyeControls3D:tracking_entity"
        )


def test_rerun_blueprint_plots_logged_fields(
    chunk: ModuleType, rerun_log: RerunLog, recording: Recording
) -> None:
    """Rerun's own selectors find our numbers."""
    blueprint = Blueprint(asset_path("viewers/rerun.rbl"), chunk)
    curves = set()
    for topic, component, selector in blueprint.curves:
        field = selector.removeprefix(".")
        found = [
            value
            for array in rerun_log.arrays(topic, component)
            for value in chunk.Selector(selector).execute_per_row(array).to_pylist()
        ]
        np.testing.assert_array_equal(np.ravel(found), recording[topic][field], err_msg=selector)
        curves.add((topic, field))
    assert curves == CURVES
    assert blueprint.contents == {"$origin/**", *(topic for topic, _ in CURVES)}


def test_rerun_blueprint_follows_the_robot(chunk: ModuleType, rerun_log: RerunLog) -> None:
    blueprint = Blueprint(asset_path("viewers/rerun.rbl"), chunk)
    assert blueprint.application == "aslip"
    assert blueprint.origins == {
        ("3D", "/cassie"),
        ("TimeSeries", "/"),
        ("TimeSeries", "/joint_states/position"),
        ("TextLog", "/log"),
    }
    for _, origin in blueprint.origins:
        assert any(entity.startswith(origin) for entity in rerun_log.entities)
    frame = rerun_log.column(blueprint.followed, "CoordinateFrame:frame", static=True)
    assert frame == [["pelvis"]]


def test_rerun_opens_log_and_blueprint_as_one_application(
    walk: Walk, chunk: ModuleType, tmp_path: Path
) -> None:
    """As the README opens them; Rerun ignores blueprints of other applications."""
    import rerun

    blueprint = asset_path("viewers/rerun.rbl")
    name = Blueprint(blueprint, chunk).application
    stream = rerun.RecordingStream(name)
    stream.save(tmp_path / "both.rrd")
    for path in (blueprint, walk[0]):
        rerun.log_file_from_path(path, recording=stream)
    stream.disconnect()
    reader = chunk.RrdReader(tmp_path / "both.rrd")
    assert {store.application_id for store in reader.blueprints()} == {name}
    recordings = reader.recordings()
    assert {store.application_id for store in recordings} == {name}
    assert any(
        "/cassie" in {str(part.entity_path) for part in reader.stream(store=store).to_chunks()}
        for store in recordings
    )


def test_shipped_layouts_are_those_of_the_recipe(
    tmp_path: Path, chunk: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    from recipes import viewer_layouts

    viewer_layouts.main(viewer_layouts.Config(out=tmp_path))
    assert len(capsys.readouterr().out.splitlines()) == 3
    for name in ("foxglove.json", "plotjuggler.xml"):
        shipped = asset_path(f"viewers/{name}").read_text(encoding="utf-8")
        assert (tmp_path / name).read_text(encoding="utf-8") == shipped
    # entities of a blueprint have random names
    shipped, made = (
        vars(Blueprint(path, chunk))
        for path in (asset_path("viewers/rerun.rbl"), tmp_path / "rerun.rbl")
    )
    assert made == shipped
