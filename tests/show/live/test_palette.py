"""Each colour has one meaning in scenes, plots and layouts."""

from aslip.robot import SIDES
from aslip.rom import Mode
from aslip.show import palette
from aslip.show.ghost import BODY_COLOR, LEG_COLORS
from aslip.show.live.readouts import _CURVES
from aslip.show.plots import MODE_COLORS
from recipes import viewer_layouts

LEGS = {"left": palette.LEFT, "right": palette.RIGHT}


def test_colours_are_parsed():
    assert palette.rgb("#1f78b5") == (31, 120, 181)
    assert palette.rgba("#ff0000") == (1.0, 0.0, 0.0, 1.0)


def test_blue_and_red_are_left_and_right():
    assert [LEG_COLORS[side] for side in SIDES] == [palette.rgba(LEGS[side]) for side in SIDES]
    assert (MODE_COLORS[Mode.LEFT], MODE_COLORS[Mode.RIGHT]) == (palette.LEFT, palette.RIGHT)
    forces = {curve.label: curve.color for curve in viewer_layouts.FORCE.curves}
    assert forces == LEGS


def test_blue_and_red_are_used_for_legs_only():
    motors = [viewer_layouts.motors(side, "position", "rad") for side in SIDES]
    plots = (viewer_layouts.VELOCITY, viewer_layouts.REWARD, *motors)
    used = {curve.color for plot in plots for curve in plot.curves}
    used |= {curve.get("stroke") for curve in _CURVES}
    assert not used & {"#1f77b4", "#d62728", palette.LEFT, palette.RIGHT}


def test_page_and_layouts_use_the_same_colours():
    page = {curve.get("label"): curve.get("stroke") for curve in _CURVES}
    layout = {curve.label: curve.color for curve in viewer_layouts.VELOCITY.curves}
    assert page["Cassie"] == layout["robot"] == palette.ROBOT
    assert page["spring-mass model"] == layout["reduced-order model"] == palette.MODEL
    assert palette.rgba(palette.MODEL) == BODY_COLOR
    assert page["command"] == layout["command"] == palette.COMMAND
