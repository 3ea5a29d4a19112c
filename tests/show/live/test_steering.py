"""Steering in all directions: sliders, texts of keys and gamepads, a ghost that turns along."""

import math
from collections.abc import Iterator

import pytest

import aslip
from aslip.envs import EPISODE_ENDS, walking_stack
from aslip.show.live import LivePage
from aslip.walking import Walker
from tests.helpers import limp
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library
from tests.show.live.helpers import wait_for
from tests.show.live.visitor import visit


@pytest.fixture(scope="module")
def walker() -> Walker:
    library = symmetric_library()
    env = aslip.make_env(stack=walking_stack(library), num_threads=1, drop=EPISODE_ENDS, seed=0)
    return Walker(limp(), env, library=library, speed=0.2)


@pytest.fixture
def page(walker: Walker) -> Iterator[LivePage]:
    walker.reset((0.2, 0.0, 0.0))
    page = LivePage(walker, port=0)
    yield page
    page.stop()


def test_texts_of_keys_and_gamepads_move_the_sliders_and_sliders_change_the_text(
    page: LivePage,
) -> None:
    field, sliders = page.controls.steering.field, page.controls.steering.sliders
    assert [slider.value for slider in sliders] == pytest.approx([0.2, 0.0, 0.0])
    for slider, value in zip(sliders, (0.4, -0.1, 0.3), strict=True):
        slider.value = value
    page.turn()
    assert page.walker.command == pytest.approx((0.4, -0.1, 0.3))
    assert field.value == "0.40, -0.10, 0.30"
    with visit(page) as visitor:
        visitor.update(field, value="0.3, 9, -0.5")
        wait_for(lambda: field.value == "0.30, 0.20, -0.50")
        page.turn()
        assert page.walker.command == pytest.approx((0.3, 0.2, -0.5))
        assert [slider.value for slider in sliders] == pytest.approx([0.3, 0.2, -0.5])
        for text in ("", "a", "1, 2", "0, 0, nan", "0,0,0,0", "1" * 200, 3, None, math.inf):
            visitor.update(field, value=text)
        visitor.update(field, value="0.1,0,0")
        wait_for(lambda: field.value == "0.10, 0.00, 0.00")
    page.turn()
    assert page.message == ""
    assert page.walker.command == pytest.approx((0.1, 0.0, 0.0))


def test_every_press_of_a_key_counts_however_slow_the_simulation_is(page: LivePage) -> None:
    """Presses of a turn are applied in their order, unknown ones are dropped."""
    labels = {
        handle.label: uuid for uuid, handle in page._server.gui._command_handle_from_uuid.items()
    }
    with visit(page) as visitor:

        def press(*names: str) -> None:
            for name in names:
                visitor.send(type="CommandTriggerMessage", uuid=labels.get(name, name))
            steering = page.controls.steering
            wait_for(lambda: steering._presses.qsize() == sum(name in labels for name in names))
            page.turn()

        press(*4 * ["forward [m/s] +0.1"], "nobody", *3 * ["turn [rad/s] -0.1"])
        assert page.walker.command == pytest.approx((0.6, 0.0, -0.3))
        press(*9 * ["forward [m/s] +0.1"], "forward [m/s] -0.1")
        assert page.walker.command[0] == pytest.approx(0.7)  # from the largest speed, 0.8
        press("forward [m/s] +0.1", "stop", "sideways [m/s] +0.05")
        assert page.walker.command == pytest.approx((0.0, 0.05, 0.0))
        for uuid in (None, 3, ["x"], {}):
            visitor.send(type="CommandTriggerMessage", uuid=uuid)
        press("stop")
    assert page.walker.command == (0.0, 0.0, 0.0)
    assert page.controls.steering.field.value == "0.00, 0.00, 0.00"


# ------------------------------------------------------------------------ standing


@pytest.fixture(scope="module")
def standing_walker() -> Walker:
    library = standing_library()
    env = aslip.make_env(
        stack="directions", library=library, num_threads=1, drop=EPISODE_ENDS, seed=0
    )
    return Walker(limp(), env, library=library, speed=0.0)


def test_a_button_and_a_key_let_robots_stand_that_can(
    page: LivePage, standing_walker: Walker
) -> None:
    assert page.controls.steering.stand is None
    assert page.keys.endswith("Q E turn, X stop")
    standing = LivePage(standing_walker, port=0)
    button = standing.controls.steering.stand
    assert button is not None
    assert standing.keys.endswith("X stop, C stand, or walk")
    try:
        with visit(standing) as visitor:
            for stand, label in ((True, "Walk"), (False, "Stand")):
                if stand:
                    visitor.update(button, value=True)
                else:  # the key C
                    commands = standing._server.gui._command_handle_from_uuid.items()
                    uuid = next(u for u, command in commands if command.hotkey == "C")
                    visitor.send(type="CommandTriggerMessage", uuid=uuid)
                wait_for(lambda: not standing.controls._clicks.empty())
                standing.turn()
                assert standing.walker.stand == stand
                assert standing.walker.td["stand"].item() == stand
                assert button.label == label
    finally:
        standing.stop()
