"""Rebuild the layouts that show a log in Foxglove, Rerun and PlotJuggler: assets/viewers/.

    python recipes/viewer_layouts.py

All three plot the same velocities, reward terms, forces and joints of the default stack. Curves of
reward terms that an experiment lacks stay empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the layouts."""

    out: Path = Path("assets/viewers")
    """Folder of the layouts."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from aslip.log.messages import LOGGED_JOINTS, ROM_FRAMES, WORLD_FRAME
from aslip.robot import CASSIE, SIDES
from aslip.robot.model import load_model
from aslip.show.palette import COMMAND, ESTIMATE, LEFT, MODEL, OTHERS, RIGHT, ROBOT, rgb
from aslip.transforms.rewards import PAPER_WEIGHTS

APPLICATION = "aslip"
"""Rerun applies a blueprint to recordings of the same application only."""

_JOINTS = "/joint_states"
_FOLLOWED = "pelvis"


@dataclass(frozen=True)
class Curve:
    """Curve of a number of a topic over time."""

    topic: str
    field: str
    label: str
    color: str
    joint: str | None = None
    """Joint in `/joint_states`, whose fields have one number per joint."""

    @property
    def foxglove(self) -> str:
        """Message path in Foxglove."""
        index = "" if self.joint is None else f"[{LOGGED_JOINTS.index(self.joint)}]"
        return f"{self.topic}.{self.field}{index}"

    @property
    def plotjuggler(self) -> str:
        """Name of the series in PlotJuggler."""
        joint = "" if self.joint is None else f"/{self.joint}"
        return f"{self.topic}{joint}/{self.field}"


@dataclass(frozen=True)
class Plot:
    """Plot of several curves on one pair of axes."""

    title: str
    curves: tuple[Curve, ...]


VELOCITY = Plot(
    "Forward velocity [m/s]",
    (
        Curve("/step", "command", "command", COMMAND),
        Curve("/reference", "body_velocity_x", "reduced-order model", MODEL),
        Curve("/truth", "pelvis_velocity_x", "robot", ROBOT),
        Curve("/estimate", "velocity_x", "estimate", ESTIMATE),
    ),
)
REWARD = Plot(
    "Reward terms",
    tuple(
        Curve("/step", f"term_{name}", name, color)
        for name, color in zip(PAPER_WEIGHTS, OTHERS, strict=True)
    ),
)
FORCE = Plot(
    "Vertical ground force [N]",
    tuple(
        Curve("/step", f"ground_force_{side}_z", side, color)
        for side, color in zip(SIDES, (LEFT, RIGHT), strict=True)
    ),
)


def motors(side: str, field: str, unit: str) -> Plot:
    """Plot of the motors of a leg.

    Args:
        side: "left" or "right".
        field: "position", "velocity" or "effort".
        unit: unit of the field.
    """
    names = [name for name in CASSIE.motor_names if name.startswith(side)]
    curves = (
        Curve(_JOINTS, field, name, color, joint=name)
        for name, color in zip(names, OTHERS, strict=True)
    )
    return Plot(f"{side.title()} motors: {field} [{unit}]", tuple(curves))


def main(config: Config) -> None:
    """Write the three layouts."""
    config.out.mkdir(parents=True, exist_ok=True)
    foxglove, rerun, plotjuggler = (
        config.out / name for name in ("foxglove.json", "rerun.rbl", "plotjuggler.xml")
    )
    foxglove.write_text(json.dumps(foxglove_layout(), indent=1) + "\n", encoding="utf-8")
    rerun_blueprint().save(APPLICATION, rerun)
    layout = ET.ElementTree(plotjuggler_layout())
    ET.indent(layout)
    layout.write(plotjuggler, encoding="UTF-8", xml_declaration=True)
    for path in (foxglove, rerun, plotjuggler):
        print(f"{path}: {path.stat().st_size} bytes")


# -------------------------------------------------------------------- Foxglove


def foxglove_layout() -> dict[str, Any]:
    """Layout in the format that the app exports and imports."""
    panels = {
        "3D!robot": _foxglove_scene(),
        "RosOut!log": {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []},
    }
    plots = [VELOCITY, REWARD, FORCE, *(motors(side, "position", "rad") for side in SIDES)]
    names = [f"Plot!{i}" for i in range(len(plots))]
    panels |= {name: _foxglove_plot(plot) for name, plot in zip(names, plots, strict=True)}
    left = _split("column", ["3D!robot", "RosOut!log"], [80, 20])
    right = _split("column", names, [1] * len(names))
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", [left, right], [55, 45]),
    }


def _split(direction: str, parts: Sequence[Any], shares: Sequence[float]) -> Any:
    """Panels side by side or stacked, as nested pairs, the form of layouts."""
    if len(parts) == 1:
        return parts[0]
    return {
        "direction": direction,
        "first": parts[0],
        "second": _split(direction, parts[1:], shares[1:]),
        "splitPercentage": round(100 * shares[0] / sum(shares), 1),
    }


def _foxglove_scene() -> dict[str, Any]:
    """3D panel that follows the robot, with axes at the frames of the reduced-order model only."""
    model = load_model()
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    shown = {WORLD_FRAME: False, **dict.fromkeys(bodies, False), **dict.fromkeys(ROM_FRAMES, True)}
    grid = {
        "layerId": "foxglove.Grid",
        "instanceId": "grid",
        "label": "Floor",
        "visible": True,
        "frameId": WORLD_FRAME,
        "size": 100,
        "divisions": 100,
        "color": "#80808080",
        "position": [0, 0, 0],
        "rotation": [0, 0, 0],
    }
    return {
        "foxglovePanelTitle": "Robot",
        "fixedFrame": WORLD_FRAME,
        "followTf": _FOLLOWED,
        "followMode": "follow-position",
        "cameraState": {
            "distance": 2.5,
            "perspective": True,
            "phi": 75,
            "thetaOffset": -25,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, -0.35],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.05,
            "far": 500,
        },
        "scene": {"transforms": {"lineWidth": 0, "showLabel": False}},
        "transforms": {f"frame:{name}": {"visible": visible} for name, visible in shown.items()},
        "topics": {"/robot_description": {"visible": True, "displayMode": "visual"}},
        "layers": {"grid": grid},
    }


def _foxglove_plot(plot: Plot) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": plot.title,
        "paths": [
            {
                "value": curve.foxglove,
                "label": curve.label,
                "color": curve.color,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for curve in plot.curves
        ],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


# ----------------------------------------------------------------------- Rerun


def rerun_blueprint() -> rrb.Blueprint:
    """Blueprint with 3D view and plots."""
    solid = [
        shape.from_fields(fill_mode="solid")
        for shape in (rr.Boxes3D, rr.Cylinders3D, rr.Ellipsoids3D)
    ]
    scene = rrb.Spatial3DView(
        name="Robot",
        origin="/cassie",
        defaults=solid,
        eye_controls=rrb.EyeControls3D(
            position=[0.8, -1.8, 1.1],
            look_target=[0.0, 0.0, 0.6],
            tracking_entity=f"/cassie/visual_geometries/{_FOLLOWED}/visual_0",
        ),
    )
    plots = [_rerun_plot(plot) for plot in (VELOCITY, REWARD, FORCE)]
    joints = rrb.TimeSeriesView(name="Joint positions [rad]", origin=f"{_JOINTS}/position")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                scene, rrb.TextLogView(name="Episodes", origin="/log"), row_shares=[80, 20]
            ),
            rrb.Vertical(*plots, joints),
            column_shares=[55, 45],
        ),
        rrb.TimePanel(timeline="message_log_time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _rerun_plot(plot: Plot) -> rrb.TimeSeriesView:
    """Plot of message fields; selectors extract them as scalars from Rerun's structures."""
    topics = list(dict.fromkeys(curve.topic for curve in plot.curves))
    overrides: dict[Any, Any] = {
        topic: [
            rr.SeriesLines(names=curve.label, colors=rgb(curve.color)).visualizer(
                mappings=[
                    VisualizerComponentMapping(
                        "Scalars:scalars",
                        "SourceComponent",
                        source_component=f"aslip_msgs.msg.{topic.strip('/').title()}:message",
                        selector=f".{curve.field}",
                    )
                ]
            )
            for curve in plot.curves
            if curve.topic == topic
        ]
        for topic in topics
    }
    return rrb.TimeSeriesView(name=plot.title, origin="/", contents=topics, overrides=overrides)


# ----------------------------------------------------------------- PlotJuggler


def plotjuggler_layout() -> ET.Element:
    """Layout with tabs of stacked plots; plots of the two legs are side by side."""
    legs = [
        [motors(side, field, unit) for side in SIDES]
        for field, unit in (("position", "rad"), ("velocity", "rad/s"), ("effort", "N m"))
    ]
    tabs = {
        "Velocity": [[VELOCITY]],
        "Reward": [[REWARD]],
        "Ground forces": [[FORCE]],
        "Motors": legs,
    }
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for name, rows in tabs.items():
        tab = ET.SubElement(window, "Tab", tab_name=name, containers="1")
        column = _splitter(ET.SubElement(tab, "Container"), "-", len(rows))
        for row in rows:
            parent = column if len(row) == 1 else _splitter(column, "|", len(row))
            for plot in row:
                _plotjuggler_plot(parent, plot)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    return root


def _splitter(parent: ET.Element, orientation: str, count: int) -> ET.Element:
    sizes = ";".join([f"{1 / count:.6f}"] * count)
    return ET.SubElement(
        parent, "DockSplitter", orientation=orientation, count=str(count), sizes=sizes
    )


def _plotjuggler_plot(parent: ET.Element, plot: Plot) -> None:
    area = ET.SubElement(parent, "DockArea", name=plot.title)
    axes = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines")
    for curve in plot.curves:
        ET.SubElement(axes, "curve", name=curve.plotjuggler, color=curve.color)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
