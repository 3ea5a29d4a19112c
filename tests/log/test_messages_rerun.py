"""Rerun reads a log, and the shipped blueprint shows it."""

import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tensordict import TensorDict

from aslip.base.assets import asset_path
from aslip.log import Recording
from tests.log.helpers import CURVES

Walk = tuple[Path, list[TensorDict]]


@pytest.fixture(scope="module")
def chunk() -> ModuleType:
    """Module with Rerun's readers of files."""
    return pytest.importorskip("rerun.chunk")


class RerunLog:
    """File as Rerun reads it: columns of entities, in order of time."""

    def __init__(self, chunks: list[Any]) -> None:
        self._batches: dict[str, list[tuple[bool, Any]]] = {}
        for part in chunks:
            entity = self._batches.setdefault(str(part.entity_path), [])
            entity.append((part.is_static, part.to_record_batch()))
        self.entities = set(self._batches)

    def column(self, entity: str, component: str, static: bool = False) -> list[Any]:
        """Rows of a component, each a list of instances."""
        return [
            row
            for is_static, batch in self._batches.get(entity, [])
            if is_static == static and component in batch.schema.names
            for row in batch.column(component).to_pylist()
        ]

    def arrays(self, entity: str, component: str) -> list[Any]:
        """Rows of a component that changes with time, as Arrow arrays."""
        return [
            batch.column(component)
            for is_static, batch in self._batches.get(entity, [])
            if not is_static and component in batch.schema.names
        ]


@pytest.fixture(scope="module")
def rerun_log(walk: Walk, chunk: ModuleType) -> RerunLog:
    """The log as Rerun reads it."""
    return RerunLog(chunk.McapReader(walk[0]).stream().to_chunks())


def test_rerun_draws_every_shape_of_the_robot(rerun_log: RerunLog, recording: Recording) -> None:
    robot = ET.fromstring(str(recording["/robot_description"]["data"][0]))
    drawn = {"box": "Boxes3D:half_sizes", "cylinder": "Cylinders3D:lengths"}
    drawn["sphere"] = "Ellipsoids3D:half_sizes"
    count = 0
    for link in robot.iter("link"):
        for i, visual in enumerate(link.findall("visual")):
            entity = f"/cassie/visual_geometries/{link.get('name')}/visual_{i}"
            geometry = visual.find("geometry")
            assert geometry is not None
            (size,) = rerun_log.column(entity, drawn[geometry[0].tag], static=True)
            assert np.min(size) > 0
            # a shape moves with the frame of its link
            (frame,) = rerun_log.column(entity, "CoordinateFrame:frame", static=True)
            assert frame == [link.get("name")]
            count += 1
    assert count > 100
    shapes = {e for e in rerun_log.entities if e.startswith("/cassie/visual_geometries/")}
    assert len({e for e in shapes if "/visual_" in e}) == count
    assert rerun_log.column("/cassie", "CoordinateFrame:frame", static=True) == [["world"]]


class Blueprint:
    """Rerun blueprint: content of its views and sources of its curves."""

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
    """Rerun's selectors find the logged numbers."""
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
