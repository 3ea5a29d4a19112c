"""Ghosts are the reference at the robot, and footholds follow from the gaits."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds, touchdown_phases, yaw_rotation
from aslip.robot import SIDES
from aslip.rom import PendulumWalk, SampledMotion, Track
from aslip.show.ghost import Ghost
from tests.library.bent import symmetric_library


def instant(library: GaitLibrary, phase: float, speed: float, yaw: float) -> TensorDict:
    reference = vars(library.lookup(torch.tensor([[phase]]), torch.tensor([[speed]])))
    turn = torch.tensor([[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]])
    truth = TensorDict(
        pelvis_position=torch.tensor([[3.0, 2.0, 0.7]]), pelvis_orientation=turn, batch_size=1
    )
    return TensorDict(reference=reference, truth=truth, batch_size=1)


def test_body_follows_the_robot_at_the_height_of_the_reference(library: GaitLibrary) -> None:
    td = instant(library, 0.2, 1.0, 0.0)
    ghost = Ghost.of(td)
    np.testing.assert_allclose(ghost.body[:2], [3.0, 2.0])
    assert ghost.body[2] == pytest.approx(float(td["reference", "body_position"][0, 2]))  # pyright: ignore
    np.testing.assert_allclose(
        ghost.left - ghost.body, td["reference", "left_foot_position"][0], atol=1e-6
    )
    td["truth", "ground_height"] = torch.tensor([[0.3]])
    np.testing.assert_allclose(Ghost.of(td).body, ghost.body + np.array([0, 0, 0.3]))


def test_feet_turn_with_the_robot(library: GaitLibrary) -> None:
    straight, turned = (Ghost.of(instant(library, 0.2, 1.0, yaw)) for yaw in (0.0, np.pi / 2))
    x, y, z = straight.left - straight.body
    np.testing.assert_allclose(turned.left - turned.body, [-y, x, z], atol=1e-6)


@pytest.mark.parametrize(
    ("phase", "stance"), [(0.2, (False, True)), (0.44, (True, True)), (0.7, (True, False))]
)
def test_stance_follows_from_the_foot_velocity(
    library: GaitLibrary, phase: float, stance: tuple[bool, bool]
) -> None:
    """Modes of a stride: right, double, left, double."""
    ghost = Ghost.of(instant(library, phase, 1.0, 0.0))
    assert (ghost.left_stance, ghost.right_stance) == stance


def test_touchdowns_of_a_pendulum_precede_its_change_of_stance() -> None:
    """Feet swing for 80 % of a step, 0.4 strides, and touch down before the stance changes."""
    for walk in (PendulumWalk(speed=0.0), PendulumWalk(speed=1.0)):
        np.testing.assert_allclose(touchdown_phases(walk), [0.4, 0.9], atol=5e-4)


def test_motion_without_swing_has_no_touchdown(library: GaitLibrary) -> None:
    sample = library.motions[0].sample(np.zeros(8))
    rest = replace(sample, feet=Track(sample.feet.position, 0 * sample.feet.velocity))
    with pytest.raises(ConfigurationError, match=r"each foot swings once .*: \[0, 0\]"):
        touchdown_phases(SampledMotion(np.array([0.0]), 0.8, rest))


def test_foothold_is_a_step_from_the_stance_foot(library: GaitLibrary) -> None:
    footholds = Footholds(library)
    foot, level = np.array([5.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    step = footholds.step("left", 0.8)
    np.testing.assert_allclose(footholds.planned("left", 0.8, foot, level), foot[:2] + step)
    about = np.array([np.cos(0.5), 0.0, 0.0, np.sin(0.5)])  # a yaw of one radian
    turned = footholds.planned("left", 0.8, foot, about) - foot[:2]
    cosine, sine = np.cos(1.0), np.sin(1.0)
    np.testing.assert_allclose(turned, np.array([[cosine, -sine], [sine, cosine]]) @ step)


def _turning(phase: float, command: tuple[float, ...], yaw: float) -> TensorDict:
    """Instant on a turning gait, with the pelvis at the yaw of the reference's body."""
    found = symmetric_library().lookup(torch.tensor([[phase]]), torch.tensor([command]))
    td = instant(GaitLibrary.load(), phase, 0.0, yaw + float(found.body_heading))
    return td.set("reference", vars(found))


def test_on_turns_feet_count_from_the_mean_heading() -> None:
    td = _turning(0.2, (0.6, 0.1, 0.8), 0.7)
    ghost = Ghost.of(td)
    foot = td["reference", "left_foot_position"][0].numpy()  # pyright: ignore
    turn = yaw_rotation(np.array([np.cos(0.35), 0.0, 0.0, np.sin(0.35)]))
    np.testing.assert_allclose(ghost.left - ghost.body, turn @ foot, atol=1e-6)


def test_planned_footholds_of_turns_are_where_the_feet_land() -> None:
    """The step in the moving frame, seen from the frame that the robot has at the touchdown."""
    library, command = symmetric_library(), (0.6, 0.1, 0.8)
    footholds, straight = Footholds(library), Footholds(GaitLibrary.load())
    for side in SIDES:
        expected = straight.touchdown_phase(side, 0.6)
        assert footholds.touchdown_phase(side, (0.6, 0.0, 0.0)) == pytest.approx(expected, abs=0.03)
        np.testing.assert_allclose(
            footholds.step(side, (0.6, 0.0, 0.0)), straight.step(side, 0.6), atol=0.02
        )
    assert footholds.step("left", command) == pytest.approx(
        footholds.step("right", (0.6, -0.1, -0.8)) * [1, -1], abs=0.01
    )
    phase, level = footholds.touchdown_phase("left", command) - 0.2, np.array([1.0, 0, 0, 0])
    later = 0.8 * 0.2 * footholds.stride(command)
    turned = np.array([np.cos(later / 2), 0, 0, np.sin(later / 2)])
    np.testing.assert_allclose(
        footholds.planned("left", command, np.zeros(3), level, phase),
        footholds.planned("left", command, np.zeros(3), turned),
        atol=1e-9,
    )
