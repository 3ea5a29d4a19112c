"""Headless browser: sliders and buttons of the page act on the robot."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from tensordict import TensorDictBase

import aslip
from aslip.envs import EPISODE_ENDS, walking_stack
from aslip.show.live import LivePage
from aslip.walking import Walker
from tests.helpers import limp
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library
from tests.show.live.helpers import PATIENCE, served, wait_for

playwright_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# few pixels, because the scene is drawn in software
_ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
_ARGUMENTS += ["--enable-unsafe-swiftshader"]
_PHONE = {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 0.5}
_PHONE |= {"has_touch": True, "is_mobile": True, "color_scheme": "dark"}
_SIZE = {"viewport": {"width": 860, "height": 480}, "device_scale_factor": 0.5}


@dataclass
class Desk:
    """Served page, and a browser that shows it."""

    live: LivePage
    tabs: Any  # of a browser, which keeps the page's program in its cache
    view: Any
    steps: list[TensorDictBase]
    script: str = ""
    running: Event = field(default_factory=Event)
    """Cleared to hold the simulation in its next step, as a slow machine does."""

    def open(self) -> Any:
        """Open another tab with the page."""
        view = self.tabs.new_page()
        view.set_default_timeout(1000 * PATIENCE)
        view.add_init_script(self.script)
        view.goto(self.live.url)
        view.get_by_role("button", name="Reset").wait_for()
        return view

    def come_back(self) -> None:
        """Load the page again."""
        self.view.goto(self.live.url)
        self.view.get_by_role("button", name="Reset").wait_for()

    def click(self, name: str) -> None:
        self.view.get_by_role("button", name=name).click()

    def speeds(self, axis: int) -> list[float]:
        """Speeds of the pelvis after every step so far [m/s]."""
        return [float(td["next", "truth", "pelvis_velocity"][0, axis]) for td in self.steps]

    def pause(self) -> int:
        """Click Pause; return the number of steps so far."""
        self.click("Pause")
        self.view.get_by_role("button", name="Resume").wait_for()
        return len(self.steps)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a window."""
    with playwright_api.sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        found = [path for name in _NAMES if (path := shutil.which(name))]
        if Path(own).is_file():
            found.append(own)
        if not found:
            pytest.skip(f"no chromium among {_NAMES}, nor playwright's own")
        browser = playwright.chromium.launch(executable_path=found[0], args=_ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def _desk(
    browser: Any, walker: Walker, policies: dict[str, Any], script: str = ""
) -> Iterator[Desk]:
    """Desk with a page; a script runs in the browser before those of the page."""
    steps: list[TensorDictBase] = []
    running = Event()
    running.set()

    def on_step(td: TensorDictBase) -> None:
        steps.append(td)
        running.wait(PATIENCE)

    live = LivePage(walker, policies, port=0, on_step=on_step)
    with served(live):
        desk = Desk(live, browser.new_context(**_SIZE), None, steps, script, running)
        desk.view = desk.open()
        yield desk
        desk.tabs.close()


@pytest.fixture(scope="module")
def opened(browser, library) -> Iterator[Desk]:
    with _desk(
        browser,
        Walker("straight", library=library, seed=0),
        {"straight": "straight", "limp": limp()},
    ) as desk:
        yield desk


@pytest.fixture
def desk(opened: Desk) -> Desk:
    """Page after a reset: the robot stands, and time runs."""
    controls = opened.live.controls
    controls.command.value, controls.policy.value = 0.0, "straight"
    if opened.live.paused:
        controls.pause.value = True
    controls.reset.value = True
    wait_for(lambda: not opened.live.paused and opened.live.walker.steps < 20)
    opened.view.get_by_role("button", name="Pause").wait_for()
    return opened


@pytest.mark.slow
def test_a_key_a_button_and_a_gamepad_let_the_robot_stand(browser):
    library = standing_library()
    env = aslip.make_env(
        stack="directions", library=library, num_threads=1, drop=EPISODE_ENDS, seed=0
    )
    walker = Walker(limp(), env, library=library)
    script = "window.pad = null; navigator.getGamepads = () => [window.pad];"
    with _desk(browser, walker, {"limp": limp()}, script) as desk:
        wait_for(lambda: desk.view.evaluate("window.aslipSteering"))
        desk.click("Stand")
        wait_for(lambda: walker.stand)
        desk.view.get_by_role("button", name="Walk").wait_for()
        desk.view.keyboard.press("KeyC")
        wait_for(lambda: not walker.stand)
        desk.view.get_by_role("button", name="Stand").wait_for()
        desk.view.evaluate(
            "window.pad = {connected: true, axes: [0, 0, 0, 0], buttons: [{pressed: true}]}"
        )
        wait_for(lambda: walker.stand)
        _steer_by_touch(browser, desk)


def _steer_by_touch(browser: Any, desk: Desk) -> None:
    """On a phone, the panel is folded, and buttons over the scene press keys."""
    phone = browser.new_context(**_PHONE)
    view = phone.new_page()
    view.set_default_timeout(1000 * PATIENCE)
    view.goto(desk.live.url)
    assert view.title() == "Cassie, live"
    view.locator("html[data-mantine-color-scheme=dark]").wait_for()
    view.get_by_role("button", name="Reset").wait_for(state="hidden")
    assert not view.get_by_label("steer").is_visible()
    walker = desk.live.walker
    view.get_by_title("forward").tap()
    wait_for(lambda: walker.command == pytest.approx((0.1, 0.0, 0.0), abs=0.005))
    view.get_by_title("stand, or walk").tap()
    wait_for(lambda: not walker.stand)
    # the whole robot is in the picture, which is narrow
    clients = desk.live._server.get_clients().values()
    wait_for(lambda: all(client.camera.fov > 1.0 for client in clients))
    phone.close()


# first, because the page of the other tests slows the browser down
@pytest.mark.slow
def test_keys_and_a_gamepad_steer_in_all_directions(browser):
    stack = walking_stack(symmetric_library())
    env = aslip.make_env(stack=stack, num_threads=1, drop=EPISODE_ENDS, seed=0)
    walker = Walker(limp(), env, library=symmetric_library(), speed=0.4)

    def wait(*command: float) -> None:
        wait_for(lambda: walker.command == pytest.approx(command, abs=0.005))

    script = "window.pad = null; navigator.getGamepads = () => [window.pad];"
    with _desk(browser, walker, {"limp": limp()}, script) as desk:
        wait_for(lambda: desk.view.evaluate("window.aslipSteering"))
        for key in ("KeyW", "ArrowUp", "KeyQ", "KeyA"):
            desk.view.keyboard.press(key)
        wait(0.6, 0.05, 0.1)
        desk.view.keyboard.press("KeyX")
        wait(0.0, 0.0, 0.0)
        desk.running.clear()
        for key in ("KeyW", "KeyW", "KeyE", "KeyW"):
            desk.view.keyboard.press(key)
            desk.view.wait_for_timeout(1100)
        desk.running.set()
        wait(0.3, 0.0, -0.1)
        desk.view.keyboard.press("KeyX")
        wait(0.0, 0.0, 0.0)
        # half the stick's way beyond its dead zone
        desk.view.evaluate("window.pad = {connected: true, axes: [0, -1, 0.56, 0]}")
        wait(0.8, 0.0, -0.4)
        desk.view.evaluate("window.pad = {connected: true, axes: [0, 0, 0, 0]}")
        wait(0.0, 0.0, 0.0)


def test_moving_the_slider_changes_the_robots_speed(desk):
    wait_for(lambda: desk.live.walker.steps > 15)
    standing = desk.speeds(0)[-10:]
    # in the middle between 0 and 2 m/s
    desk.view.locator(".mantine-Slider-trackContainer").first.click()
    wait_for(lambda: desk.live.walker.command == pytest.approx(1.0, abs=0.06))
    wait_for(lambda: sum(desk.speeds(0)[-15:]) / 15 > 0.7)
    assert sum(standing) / 10 < 0.4


def test_push_accelerates_the_robot_to_its_left(desk):
    count = desk.pause()
    desk.view.get_by_role("slider").nth(2).press("End")
    desk.click("Push")
    for _ in range(4):
        desk.click("Step")
    wait_for(lambda: len(desk.steps) == count + 4)
    assert desk.live.controls.pushes.size.value == 300
    # 300 N on 33 kg for 0.12 s
    assert desk.speeds(1)[-1] - desk.speeds(1)[count - 1] > 0.5


# shares of dark and of orange pixels of the scene, which has its own canvas beside the plot's;
# the number of pixels depends on the speed of the machine
_SHARES = """() => {
    const canvas = document.querySelector('canvas[data-engine^="three.js"]');
    const copy = document.createElement('canvas');
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext('2d');
    context.drawImage(canvas, 0, 0);
    const data = context.getImageData(0, 0, copy.width, copy.height).data;
    let [dark, orange] = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
        if (data[i + 3] && data[i] + data[i + 1] + data[i + 2] < 150) dark++;
        if (data[i + 3] && data[i] > 150 && data[i + 2] < 90) orange++;
    }
    return [4 * dark / data.length, 4 * orange / data.length];
}"""


@pytest.mark.slow
def test_page_draws_the_robot(desk):
    """Dark and orange parts appear with the robot, and disappear with it."""
    desk.live.controls.rom.value = "hidden"  # its right leg and foothold are red
    desk.pause()
    least = 0.002, 0.0002

    def show(visible: bool) -> None:
        for mesh in desk.live._scene._scene.robot._meshes:
            mesh.visible = visible

    def drawn() -> list[bool]:
        shares = desk.view.evaluate(_SHARES)
        return [share > some for share, some in zip(shares, least, strict=True)]

    wait_for(lambda: all(drawn()))
    show(False)
    wait_for(lambda: not any(drawn()))
    show(True)
    wait_for(lambda: all(drawn()))
