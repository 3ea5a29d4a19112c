"""Page of a robot that another program moves."""

from collections.abc import Iterator

import numpy as np
import pytest

from aslip.robot import CASSIE
from aslip.show.live import RobotPage
from tests.show.live.test_page import click


@pytest.fixture(scope="module")
def page() -> Iterator[RobotPage]:
    page = RobotPage(port=0)
    yield page
    page.close()


def test_the_page_shows_configuration_and_lines(page: RobotPage) -> None:
    qpos = CASSIE.standing.copy()
    qpos[0] = 0.3
    page.show(qpos, {"client": "<none>"})
    assert page._scene._floor.position[0] == pytest.approx(0.7)
    assert "client" in page._lines.content
    assert "&lt;none&gt;" in page._lines.content


def test_a_push_turns_with_the_robot(page: RobotPage) -> None:
    """A push to the left of a robot that faces along y goes along -x."""
    qpos = CASSIE.standing.copy()
    qpos[CASSIE.indices.pelvis_orientation] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    page.show(qpos, {})
    assert not list(page.forces())
    page.pushes.size.value = 100
    click(page.pushes.button)
    (force,) = page.forces()
    np.testing.assert_allclose(force, [-100, 0, 0], atol=1e-9)
