"""Lines, bars and curves show the status, rewards and speeds."""

import re

import numpy as np
import pytest

from aslip.robot import CASSIE
from aslip.show.live.readouts import PLOT_SPAN, Readouts
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import Walker

STATUS = [("time", "12.34 s", "paused"), ("moved", "1 m", "<left>")], "<fallen>"


@pytest.fixture
def readouts(server) -> Readouts:
    return Readouts(server.gui)


@pytest.fixture
def shown(server, monkeypatch) -> dict:
    """Elements that the readouts add to the page, by kind."""
    made = {}
    for kind in ("html", "uplot"):
        add = getattr(server.gui, f"add_{kind}")

        def keep(*args, add=add, kind=kind, **settings):
            made.setdefault(kind, []).append(add(*args, **settings))
            return made[kind][-1]

        monkeypatch.setattr(server.gui, f"add_{kind}", keep)
    return made


def test_lines_show_the_status_and_escape_markup(shown, readouts):
    readouts.show(*STATUS)
    words = " ".join(re.sub("<.*?>", " ", shown["html"][0].content).split())
    assert words == "time 12.34 s paused moved 1 m &lt;left&gt; &lt;fallen&gt;"


def test_bars_have_the_names_values_and_lengths_of_the_terms(shown, readouts, library):
    td = Walker("straight", library=library, speed=1.0, seed=0).step()
    readouts.add(td)
    readouts.show(*STATUS)
    content = shown["html"][-1].content
    rows = re.findall(r"<td.*?>(\w+)</td>.*?width:([\d.]+)%.*?>([\d.]+)</td>", content)
    expected = {name: float(td["next", "reward_terms", name]) for name in PAPER_WEIGHTS}
    expected["reward"] = float(td["next", "reward"])
    assert [name for name, _, _ in rows] == list(expected)
    for name, width, value in rows:
        assert float(width) == pytest.approx(100 * expected[name], abs=0.06)
        assert float(value) == pytest.approx(expected[name], abs=0.006)


def test_curves_are_the_last_seconds_of_model_robot_and_command(shown, readouts, library):
    walker = Walker("straight", library=library, speed=0.5, seed=0)
    steps = [walker.step() for _ in range(3)]
    walker.command = 1.0
    steps.append(walker.step())
    for td in steps:
        readouts.add(td)
    readouts.show(*STATUS)
    time, model, robot, command = shown["uplot"][0].data
    np.testing.assert_allclose(time[-4:], CASSIE.policy_period * np.arange(-3, 1))
    np.testing.assert_allclose(command[-4:], [0.5, 0.5, 0.5, 1.0])
    for i, td in enumerate(steps, start=-4):
        assert model[i] == float(td["next", "reference", "body_velocity"][0, 0])
        assert robot[i] == float(td["next", "truth", "pelvis_velocity"][0, 0])
    for _ in range(400):
        readouts.add(steps[0])
    readouts.show(*STATUS)
    data = shown["uplot"][0].data
    assert {len(column) for column in data} == {round(PLOT_SPAN / CASSIE.policy_period) + 1}
    assert np.isfinite(data).all()
