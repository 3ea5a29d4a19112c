"""Invalid messages of visitors are dropped or clamped."""

import math
from collections.abc import Iterator
from typing import Any

import pytest

from aslip.library import GaitLibrary
from aslip.show.live import LivePage
from aslip.walking import Walker
from tests.show.live.helpers import wait_for
from tests.show.live.visitor import Visitor, visit

INVALID = [None, "1.0", math.nan, {"a": 1}, True]


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


def test_values_are_clamped_to_their_range_and_nothing_else_is_set(page):
    slider = page.controls.command
    with visit(page) as visitor:
        visitor.update(page.controls.pushes.size, value=1e308)
        visitor.update(page.controls.pushes.direction, value=-(2**63))
        visitor.update(slider, value=1.0, update_cb=5, removed=True)
        visitor.update(page.controls.auto_reset, value=False)
        settle(page, visitor)
    pushes, settings = page.controls.pushes, page.controls.settings()
    assert (pushes.size.value, pushes.direction.value) == (pushes.size.max, pushes.direction.min)
    assert slider._impl.update_cb != 5
    assert not slider._impl.removed
    assert (settings.command, settings.auto_reset) == (1.0, False)
    assert serves_others(page)


def test_malformed_updates_are_dropped(page, capfd):
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
    [{"type": "GuiFormDirtyMessage", "uuid": "x" * 1000}, {"type": "ShareUrlRequest"}],
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
