"""Invalid messages of visitors are dropped or clamped."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from aslip.library import GaitLibrary
from aslip.show.live import LivePage
from aslip.walking import Walker
from tests.show.live.helpers import wait_for
from tests.show.live.visitor import Visitor, visit

INVALID = [None, "1.0", "9" * 309, math.nan, [0.5], {"a": 1}, b"x", True]


@pytest.fixture(scope="module")
def opened(library: GaitLibrary) -> Iterator[tuple[LivePage, list[float]]]:
    """Page of a walking robot, and the first values of its sliders."""
    page = LivePage(Walker("straight", library=library, speed=0.5, seed=0), port=0)
    yield page, [slider.value for slider in sliders(page)]
    page.stop()


@pytest.fixture
def page(opened: tuple[LivePage, list[float]]) -> LivePage:
    """Page with its first values."""
    for slider, value in zip(sliders(opened[0]), opened[1], strict=True):
        slider.value = value
    return opened[0]


def sliders(page: LivePage) -> list[Any]:
    return [page.controls.pushes.size, page.controls.pushes.direction, page.controls.command]


def serves_others(page: LivePage) -> bool:
    """True if a later visitor receives the page."""
    with visit(page) as later:
        return bool(later.messages("GuiSliderMessage", lambda m: "force" in m["props"]["label"]))


def settle(page: LivePage, visitor: Visitor) -> None:
    """Wait until the server has handled all messages."""
    clicks: list[str] = []
    visitor.update(page.controls.step, value=True)
    wait_for(lambda: clicks.extend(page.controls.clicks()) or "step" in clicks)


@pytest.mark.parametrize("value", [1e308, -(2**63), math.inf])
def test_huge_numbers_are_clamped_and_the_page_stays_open(page, value):
    with visit(page) as visitor:
        for slider in sliders(page):
            visitor.update(slider, value=value)
        settle(page, visitor)
    for slider in sliders(page):
        assert slider.value == (slider.max if value > 0 else slider.min)
    assert serves_others(page)
    page.turn()
    assert page.message == ""


@pytest.mark.parametrize("value", INVALID, ids=repr)
def test_invalid_numbers_and_choices_change_nothing(page, value):
    before = page.controls.settings(), page.controls.pushes.force().tolist()
    controls = page.controls
    with visit(page) as visitor:
        for control in (controls.command, controls.pushes.size, controls.policy, controls.rom):
            visitor.update(control, value=value)
        if value is not True:
            visitor.update(controls.auto_reset, value=value)
            visitor.update(controls.reset, value=value)
        settle(page, visitor)
    assert (page.controls.settings(), page.controls.pushes.force().tolist()) == before
    assert not list(page.controls.clicks())
    page.turn()
    assert page.message == ""
    assert serves_others(page)


def test_visitors_can_set_values_only(open_page):
    page = open_page()
    slider = page.controls.command
    with visit(page) as visitor:
        for name in ("update_cb", "props", "gui_api", "is_button", "removed", "nothing"):
            visitor.update(slider, **{name: "x"})
        visitor.update(slider, value=1.0, update_cb=5, removed=True)
        settle(page, visitor)
    assert slider._impl.update_cb != 5
    assert not slider._impl.removed
    assert slider.value == 1.0
    assert serves_others(page)


def test_malformed_updates_are_dropped(open_page, capfd):
    page = open_page()
    with visit(page) as visitor:
        for uuid in ("nobody", 5, ["x"], None):
            visitor.send(type="GuiUpdateMessage", uuid=uuid, updates={"value": 1})
        for updates in ([], "value", None, {}, 7):
            uuid = page.controls.command._impl.uuid
            visitor.send(type="GuiUpdateMessage", uuid=uuid, updates=updates)
        settle(page, visitor)
    assert serves_others(page)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(
    "message",
    [
        {"type": "GuiFormDirtyMessage", "uuid": "x" * 1000},
        {"type": "GuiFormSubmitMessage", "uuid": "x"},
        {"type": "ShareUrlRequest"},
    ],
    ids=lambda message: message["type"],
)
def test_other_messages_are_dropped(page, monkeypatch, message: dict[str, Any]):
    asked = []
    monkeypatch.setattr("viser.ViserServer.request_share_url", lambda *_: asked.append(1))
    buffer = page._server._websock_server._broadcast_buffer
    before = len(buffer.message_from_id)
    with visit(page) as visitor:
        visitor.send(**message)
        settle(page, visitor)
    assert not asked
    assert len(buffer.message_from_id) == before


def test_valid_values_pass(open_page):
    page = open_page({"straight": "straight", "other": "straight"})
    controls = page.controls
    with visit(page) as visitor:
        visitor.update(controls.command, value=1)
        visitor.update(controls.pushes.size, value=250)
        visitor.update(controls.policy, value="other")
        visitor.update(controls.auto_reset, value=False)
        settle(page, visitor)
    settings = controls.settings()
    assert (settings.command, settings.policy, settings.auto_reset) == (1.0, "other", False)
    assert controls.pushes.size.value == 250
