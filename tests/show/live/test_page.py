"""Settings and clicks act on the robot, turn by turn, without a browser."""

import urllib.request
from contextlib import nullcontext

import numpy as np
import pytest

from aslip.errors import AssetError, ConfigurationError
from aslip.robot import CASSIE
from aslip.show.live import LivePage
from aslip.show.live.readouts import _REDRAWS
from aslip.walking import Walker
from tests.helpers import limp
from tests.show.live.helpers import served, wait_for
from tests.show.live.visitor import visit


def walk(page: LivePage, turns: int) -> None:
    for _ in range(turns):
        page.turn()


def click(button) -> None:
    """Click a button as a browser does."""
    button.value = True


def test_command_acts_on_the_very_next_step(open_page):
    """The slider starts at the command as written, and not at 0.3 in single precision."""
    steps = []
    page = open_page(on_step=steps.append, speed=0.3)
    assert page.controls.command.value == 0.3 != page.walker.command
    page.turn()
    page.controls.command.value = 1.0
    page.turn()
    assert [float(td["command"]) for td in steps] == pytest.approx([0.3, 1.0])
    assert page.url.startswith("http://127.0.0.1:")


def test_pause_stops_time_and_a_click_steps_once(open_page):
    page = open_page()
    walk(page, 3)
    click(page.controls.pause)
    walk(page, 3)
    assert page.paused
    assert page.walker.steps == 3
    click(page.controls.step)
    click(page.controls.step)
    walk(page, 1)
    assert page.walker.steps == 4
    walk(page, 5)
    assert page.walker.steps == 5
    assert page.controls.pause.label == "Resume"
    assert not page.controls.step.disabled
    click(page.controls.pause)
    walk(page, 2)
    assert page.walker.steps == 7
    assert page.controls.pause.label == "Pause"


def test_new_visitors_see_the_present_poses(open_page):
    page = open_page(speed=1.0)
    for _ in range(2):
        walk(page, 7)
        with visit(page) as visitor:
            places = {
                name: visitor.messages("SetPositionMessage", lambda m, name=name: m["name"] == name)
                for name in ("/world/floor", "/world/robot/pelvis", "/world/rom/body")
            }
        height = float(page.walker.td["truth", "pelvis_position"][0, 2])
        assert places["/world/robot/pelvis"][-1]["position"][2] == pytest.approx(height, abs=1e-4)
        x = float(page.walker.td["truth", "qpos"][0, 0])
        assert places["/world/floor"][-1]["position"][0] == pytest.approx(-x % 1.0, abs=1e-4)
        height = float(page.walker.td["reference", "body_position"][0, 2])
        assert places["/world/rom/body"][-1]["position"][2] == pytest.approx(height, abs=1e-4)


def test_two_visitors_see_the_same_and_one_may_return(open_page):
    page = open_page()
    command = page.controls.command

    def is_slow_walk(message):
        return message["uuid"] == command._impl.uuid and message["updates"].get("value") == 0.65

    with visit(page) as first, visit(page) as second:
        first.update(command, value=0.65)
        assert second.messages("GuiUpdateMessage", is_slow_walk)
    with visit(page) as returned:
        assert returned.messages("GuiUpdateMessage", is_slow_walk)
    page.turn()
    assert page.walker.command == pytest.approx(0.65, abs=1e-6)


def test_a_paused_page_is_redrawn_for_a_new_visitor_until_it_is_laid_out(open_page, monkeypatch):
    page, shown = open_page(), []
    click(page.controls.pause)
    walk(page, 12)
    show = page._readouts.show
    monkeypatch.setattr(page._readouts, "show", lambda *status: shown.append(show(*status)))
    with visit(page):
        wait_for(lambda: page._readouts.redrawing)
    walk(page, 100)
    assert len(shown) == _REDRAWS


@pytest.mark.parametrize(("degrees", "ahead", "left"), [(0, 1, 0), (90, 0, 1), (-135, -1, -1)])
def test_push_has_its_direction_size_and_duration(open_page, degrees, ahead, left):
    steps = []
    page = open_page(on_step=steps.append)
    walk(page, 1)
    page.controls.pushes.direction.value = degrees
    page.controls.pushes.size.value = 150
    click(page.controls.pushes.button)
    walk(page, 6)
    pushed = [td["push"][0].numpy() for td in steps if "push" in td and td["push"].any()]
    assert len(pushed) * CASSIE.policy_period == pytest.approx(0.12)
    direction = np.array([ahead, left, 0]) / np.hypot(ahead, left)
    # the heading is 0 to within two degrees
    np.testing.assert_allclose(pushed[0], 150 * direction, atol=6)
    assert np.linalg.norm(pushed[0]) == pytest.approx(150, rel=1e-5)


def test_policies_are_switched_without_a_restart(open_page):
    still = limp()
    page = open_page({"straight": "straight", "limp": still})
    walk(page, 3)
    assert page.walker.policy is not still
    page.controls.policy.value = "limp"
    walk(page, 1)
    assert page.walker.policy is still
    assert page.walker.steps == 4


def test_fall_is_reported_and_reset_after_a_second(open_page):
    page = open_page({"limp": limp()}, speed=1.0)
    fell_after = []
    for falls in (1, 2):
        while not page.walker.fallen:
            page.turn()
        fell_after.append(page.walker.steps)
        assert page.falls == falls
        assert "fallen" in page.message
        turns = 0
        while page.walker.fallen:
            page.turn()
            turns += 1
        assert turns * CASSIE.policy_period == pytest.approx(1.0, abs=CASSIE.policy_period)
        assert page.message == ""
        assert page.walker.command == 1.0
    assert fell_after[0] == fell_after[1] > 5


def test_without_automatic_reset_the_robot_stays_down_until_a_click(open_page):
    """And while the page is paused."""
    page = open_page({"limp": limp()}, speed=1.0)
    page.controls.auto_reset.value = False
    while not page.walker.fallen:
        page.turn()
    steps = page.walker.steps
    walk(page, 50)
    assert page.walker.fallen
    assert page.walker.steps == steps
    assert page.falls == 1
    assert "Reset" in page.message
    click(page.controls.reset)
    walk(page, 2)
    assert not page.walker.fallen
    assert page.walker.steps == 2


def test_invalid_setting_is_reported_and_the_robot_walks_on(open_page):
    page = open_page(speed=0.5)
    page.controls.command.value = 7.0
    walk(page, 3)
    assert "7" in page.message
    assert page.walker.command == 0.5
    assert page.walker.steps == 3
    page.controls.command.value = 0.7
    page.turn()
    assert page.message == ""
    assert page.walker.command == pytest.approx(0.7)


def test_live_page_does_not_change_the_walk(open_page, library):
    page = open_page(speed=1.0)
    alone = Walker("straight", library=library, speed=1.0, seed=0)
    walk(page, 10)
    for _ in range(10):
        alone.step()
    np.testing.assert_array_equal(page.walker.td["truth", "qpos"], alone.td["truth", "qpos"])


def test_missing_policies_are_named_before_the_server_starts(open_page, monkeypatch):
    monkeypatch.setattr("aslip.show.live.page.start_server", lambda *_: pytest.fail("served"))
    with pytest.raises(AssetError, match="nobody"):
        open_page({"straight": "straight", "other": "nobody"})
    with pytest.raises(ConfigurationError, match="empty"):
        open_page({})
    with pytest.raises(ConfigurationError, match="'directions' does not fit the environment"):
        open_page({"straight": "straight", "all directions": "directions"})


def test_stop_ends_serving_and_closes_the_page(open_page):
    page = open_page()
    with served(page):
        wait_for(lambda: page.walker.steps > 3)
        with pytest.raises(ConfigurationError, match="already"):
            page.serve()
        assert urllib.request.urlopen(page.url).status == 200
    steps = page.walker.steps
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(page.url)
    with pytest.raises(ConfigurationError, match="closed"):
        page.serve()
    assert page.walker.steps == steps
    page.stop()


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_errors_on_a_step_and_ctrl_c_end_serving(open_page, error):
    def fail(td):
        raise error

    page = open_page(on_step=fail)
    with nullcontext() if error is KeyboardInterrupt else pytest.raises(error):
        page.serve()
    assert page.walker.steps == 1
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(page.url)


def test_messages_for_new_visitors_do_not_accumulate(open_page):
    page = open_page(speed=1.0)
    kept = []
    for _ in range(2):
        walk(page, 20)
        kept.append(len(page._server._websock_server._broadcast_buffer.message_from_id))
    assert kept[0] == kept[1]
