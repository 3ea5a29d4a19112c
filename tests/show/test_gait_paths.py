"""Picture of gaits from above."""

import numpy as np

from aslip.library import GaitLibrary
from aslip.show.gait_paths import path_figure
from aslip.show.palette import LEFT, MODEL, RIGHT


def test_each_panel_shows_body_footholds_and_toes(library: GaitLibrary) -> None:
    gaits = [library.gaits[i] for i in (0, 10, 15, 20)]
    panels = path_figure(gaits, strides=2).axes
    assert len(panels) == 6
    assert [axes.axison for axes in panels] == 4 * [True] + 2 * [False]
    for axes, gait in zip(panels, gaits, strict=False):
        body, *feet = axes.lines
        assert body.get_color() == MODEL
        travelled = 2 * gait.speed * gait.stride
        np.testing.assert_allclose(np.asarray(body.get_xdata())[-1], travelled, atol=1e-6)
        for leg, color in enumerate((LEFT, RIGHT)):
            _, *footsteps = [line for line in feet if line.get_color() == color]
            place = gait.feet.position[0, leg]
            for i, line in enumerate(footsteps):
                heel, toe = np.array(line.get_data()).T
                np.testing.assert_allclose(toe - heel, [0.15, 0.0], atol=1e-12)
                ahead = i * gait.speed * gait.stride
                np.testing.assert_allclose(heel[0] + 0.06, place[0] + ahead, atol=1e-9)
                np.testing.assert_allclose(heel[1], place[1], atol=1e-12)
