"""Visitors move, take away and add stones, and the robot walks on what is left."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra 'live' is not installed")

import aslip
from aslip.envs import EPISODE_ENDS
from aslip.envs.directions import course_stack, planned_stack
from aslip.robot import SIDES
from aslip.show.live import LivePage
from aslip.show.live.stones import Grip, ScenePlace
from aslip.sim.course import pattern
from aslip.transforms.plan_state import footholds_in_world, landing_foot
from aslip.walking import Walker
from tests.show.live.helpers import wait_for
from tests.show.live.visitor import Visitor, visit

EYE = np.array([2.0, 0.0, 1.0])  # of the visitor
STONE = 3
SPARE = 2


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    course = np.pad(pattern("straight").stones, ((0, SPARE), (0, 0)), constant_values=np.nan)
    env = aslip.make_env(
        stack=course_stack(planned_stack(), course[None]), drop=EPISODE_ENDS, num_threads=1, seed=0
    )
    page = LivePage(Walker("stones", env, speed=0.4), port=0)
    yield page
    page.stop()


@pytest.fixture
def course(page: Any) -> np.ndarray:
    """Stones at the start, all in their places, a policy step after the robot's."""
    page.controls.stones.restore.value = True
    page.controls.reset.value = True
    page.turn()
    page.turn()
    stones = page.walker.stones
    assert stones is not None
    return stones


def send(page: Any, visitor: Visitor, kind: str, name: object, **entries) -> None:
    """Send a click or a part of a drag, and wait until the server has it."""
    clicks: list[str] = []
    visitor.send(type=f"SceneNode{kind}Message", name=name, instance_index=None, **entries)
    visitor.update(page.controls.step, value=True)
    wait_for(lambda: clicks.extend(page.controls.clicks()) or "step" in clicks)


def drag(page: Any, visitor: Visitor, name: str, *points: np.ndarray, modifier=None) -> None:
    for phase, point in zip(("start", "update", "end"), points, strict=False):
        places = {"start_position": [0.0] * 3, "end_position": np.asarray(point).tolist()}
        screen = {"start_screen_pos": [0.0, 0.0], "end_screen_pos": [0.0, 0.0]}
        send(
            page, visitor, "Drag", name,
            phase=phase, button="left", modifier=modifier, owner="", **places, **screen,
        )  # fmt: skip


def click(page: Any, visitor: Visitor, name: str) -> None:
    rays = {"ray_origin": [0.0] * 3, "ray_direction": [0.0, 0.0, -1.0], "screen_pos": [0.0, 0.0]}
    send(page, visitor, "Click", name, modifier=None, owner="", **rays)


def in_scene(page: Any, point: np.ndarray) -> np.ndarray:
    """Point of the world in the scene, found by its inverse."""
    place, low = page._scene.place, np.zeros(3)
    turned = np.array([place._in_world(low + axis) - place._in_world(low) for axis in np.eye(3)])
    return turned @ (point - place._in_world(low))


def test_a_dragged_stone_follows_the_pointer_and_the_robot_stands_on_it(page: Any, course):
    """The pointer's point is nearer to the eye than the stone, as on a plane that faces it."""
    goal = course[STONE, :3] + [0.1, -0.05, 0.0]
    with visit(page) as visitor:
        start, end = (EYE + 0.9 * (in_scene(page, p) - EYE) for p in (course[STONE, :3], goal))
        drag(page, visitor, f"/world/stones/{STONE}", start, end)
        page.turn()
    moved = page.walker.stones
    # the robot has walked on by a policy step at most
    np.testing.assert_allclose(moved[STONE, :3], goal, atol=0.02)
    np.testing.assert_array_equal(np.delete(moved, STONE, 0), np.delete(course, STONE, 0))
    np.testing.assert_array_equal(page.walker.env.base_env.stones[0], moved)
    np.testing.assert_allclose(
        page._server.scene.get_handle_by_name(f"/world/stones/{STONE}").position[:2],
        moved[STONE, :2],
        atol=1e-6,
    )


def test_with_shift_a_stone_moves_up_turn_by_turn(page: Any, course):
    """Robot and picture have each of its heights."""
    for height in (0.1, 0.2):
        with visit(page) as visitor:
            point = in_scene(page, course[STONE, :3])
            drag(
                page, visitor, f"/world/stones/{STONE}", point, point + np.array([0, 0, 0.1]),
                modifier="shift",
            )  # fmt: skip
            page.turn()
        assert page.walker.stones[STONE, 2] == pytest.approx(height, abs=0.01)
        assert page.walker.env.base_env.stones[0, STONE, 2] == page.walker.stones[STONE, 2]
        box = page._server.scene.get_handle_by_name(f"/world/stones/{STONE}")
        top = box.position[2] + box.dimensions[2] / 2
        assert top == pytest.approx(height, abs=0.01)


def test_a_click_takes_a_stone_away_and_another_is_added(page: Any, course):
    with visit(page) as visitor:
        click(page, visitor, f"/world/stones/{STONE}")
        page.turn()
        assert np.isnan(page.walker.stones[STONE]).all()
        assert page.walker.td["stones", "corners"].isfinite().any()
        for _ in range(SPARE + 3):
            page.controls.stones.add.value = True
            page.turn()
    there = np.isfinite(page.walker.stones[:, 0])
    assert there.all()
    new = page.walker.stones[STONE, :2] - page.walker.td["truth", "pelvis_position"][0, :2].numpy()
    np.testing.assert_allclose(new, [0.4, 0.6], atol=0.1)


def test_changed_stones_stay_at_a_reset_until_they_are_restored(page: Any, course):
    with visit(page) as visitor:
        click(page, visitor, f"/world/stones/{STONE}")
    for button in (page.controls.stones.add, page.controls.reset):
        page.turn()
        button.value = True
    page.turn()
    page.turn()
    changed = page.walker.stones
    assert not np.array_equal(changed, course, equal_nan=True)
    np.testing.assert_array_equal(page.walker.env.base_env.stones[0], changed)
    page.controls.stones.restore.value = True
    page.turn()
    np.testing.assert_array_equal(page.walker.stones, course)


@pytest.mark.parametrize("point", [[np.nan] * 3, [1e308] * 3], ids=repr)
def test_invalid_drags_are_dropped(page, course, point, capfd):
    with visit(page) as visitor:
        for name in ("/world/stones/3", "/world/stones/999", 5):
            for phase in ("start", "update", 7):
                send(
                    page, visitor, "Drag", name,
                    phase=phase, button="left", modifier=None, owner="",
                    start_position=[0.0] * 3, end_position=point,
                    start_screen_pos=[0.0, 0.0], end_screen_pos=[0.0, 0.0],
                )  # fmt: skip
        page.turn()
    np.testing.assert_array_equal(page.walker.stones, course)
    assert "Traceback" not in capfd.readouterr().err


def test_stones_stay_near_the_robot():
    """Also those dragged towards the horizon."""
    place = ScenePlace(np.array([3.0, 1.0]), 0.2, 0.5, 0.5)
    for point in ([0.0, 5.0, 3.0], [-50.0, 0.0, 0.999], [0.0, 0.0, 1.0]):
        found = place.gripped(Grip("", "update", np.array(point), EYE, upright=False), 0.2)
        assert np.isfinite(found).all()
        assert found[2] == 0.2
        assert np.linalg.norm(found[:2] - place._in_world(EYE)[:2]) <= 10 + 1e-9


def test_discs_are_at_the_footholds_of_the_plan_while_the_robot_walks(page: Any, course):
    def discs() -> np.ndarray:
        names = [f"/world/footholds/{side}_{i}" for side in SIDES for i in range(2)]
        found = map(page._server.scene.get_handle_by_name, names)
        return np.array([disc.position for disc in found if disc.visible])

    footholds = footholds_in_world(page.walker.td)[0].numpy()
    truth = page.walker.td["truth", "pelvis_position"][0, :2].numpy()
    drawn = discs()
    assert len(drawn) == len(footholds) == 4
    first = int(landing_foot(page.walker.td))
    order = [0, 2, 1, 3] if first == 0 else [2, 0, 3, 1]  # drawn by foot
    np.testing.assert_allclose(drawn[order, :2], footholds[:, :2] - truth, atol=1e-4)
    page.walker.reset(stand=True)
    page.turn()
    assert not len(discs())
    page.walker.stand = False
