"""Commands of three components: drawn in the library's region, filtered."""

from __future__ import annotations

import pytest
import torch

from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.library import GaitLibrary
from aslip.transforms import SpeedCommand, VelocityCommand
from aslip.transforms.command import approach_command
from tests.helpers import seeded
from tests.library.bent import Bent, symmetric_library

PERIOD = 0.03


@pytest.fixture(scope="module")
def cut(library: GaitLibrary) -> GaitLibrary:
    """Library over an octahedron of commands with the zero command in its middle."""
    gait = library.gaits[0]

    class Still(Bent):
        def __init__(self, x: float, y: float, w: float) -> None:
            super().__init__(gait, y, w)
            self.command[0] = x

    motions = [
        Still(x, y, w)
        for x in (-0.2, 0.0, 0.2)
        for y in (-0.2, 0.0, 0.2)
        for w in (-1.0, 0.0, 1.0)
        if abs(x) / 0.2 + abs(y) / 0.2 + abs(w) <= 1
    ]
    return GaitLibrary.from_motions(motions, samples=8, missing=True)


def test_commands_fill_a_region_that_is_no_box(cut: GaitLibrary) -> None:
    command = seeded(VelocityCommand(cut, straight=0, turning=0, in_place=0)).draw((2000, 3))
    gauge = command[:, 0].abs() / 0.2 + command[:, 1].abs() / 0.2 + command[:, 2].abs()
    assert gauge.max() <= 1 + 1e-5
    # uniform in an octahedron: the share within half its size is an eighth
    assert float((gauge < 0.5).float().mean()) == pytest.approx(1 / 8, abs=0.03)
    assert cut.covers(command).all()


def test_shares_of_special_commands(cut: GaitLibrary) -> None:
    command = seeded(VelocityCommand(cut, straight=0.3, turning=0.2, in_place=0.1)).draw((4000, 3))
    zero = command == 0
    kinds = {
        "straight": (zero[:, 1] & zero[:, 2] & ~zero[:, 0], 0.3),
        "turning": (zero[:, 0] & zero[:, 1] & ~zero[:, 2], 0.2),
        "in place": (zero.all(-1), 0.1),
        "any": (~zero.any(-1), 0.4),
    }
    for name, (rows, share) in kinds.items():
        assert float(rows.float().mean()) == pytest.approx(share, abs=0.03), name


def test_draws_follow_the_seed_and_shares_are_checked(cut: GaitLibrary) -> None:
    first, second = seeded(VelocityCommand(cut)), seeded(VelocityCommand(cut))
    assert torch.equal(first.draw((20, 3)), second.draw((20, 3)))
    second.set_seed(1)
    assert not torch.equal(first.draw((20, 3)), second.draw((20, 3)))
    with pytest.raises(ConfigurationError, match="add up to at most 1"):
        VelocityCommand(cut, straight=0.8, turning=0.3)
    with pytest.raises(ConfigurationError, match="turning must be"):
        VelocityCommand(cut, turning=-0.1)


def test_special_commands_need_the_zero_command(library: GaitLibrary) -> None:
    motions = [Bent(library.gaits[i], y, 0.1) for i in (4, 8) for y in (-0.2, 0.2)]
    away = GaitLibrary.from_motions(motions, samples=8)
    with pytest.raises(SpeedOutOfRangeError, match="0, 0, 0"):
        VelocityCommand(away)
    command = seeded(VelocityCommand(away, straight=0, turning=0, in_place=0)).draw((9, 3))
    assert away.covers(command).all()


def test_commands_outside_the_region_are_those_of_the_nearest_inside(cut: GaitLibrary) -> None:
    command = torch.tensor([[0.1, 0.05, 0.2], [0.2, 0.2, 0.0], [0.3, 0.0, 0.0]])
    assert cut.covers(command).tolist() == [[True], [False], [False]]
    nearest = cut.nearest(command)
    assert torch.equal(nearest[0], command[0])
    torch.testing.assert_close(nearest[1:], torch.tensor([[0.1, 0.1, 0.0], [0.2, 0.0, 0.0]]))
    with pytest.raises(ShapeError, match=r"\(\.\.\., 3\)"):
        cut.covers(torch.zeros(2, 1))


def test_speeds_alone_are_no_commands_of_several_axes() -> None:
    with pytest.raises(ConfigurationError, match="3 numbers; use VelocityCommand"):
        SpeedCommand(symmetric_library())


# ------------------------------------------------------------------------ the filter


def test_a_filtered_command_goes_straight_to_the_command_at_the_largest_rate() -> None:
    past, command = torch.zeros(1, 3), torch.tensor([[0.6, 0.2, -1.2]])
    rates, path = (2.0, 1.5, 2.0), [past]
    while not torch.equal(path[-1], command):
        path.append(approach_command(path[-1], command, rates))
    # the yaw rate takes longest: 1.2 rad/s at 2 rad/s^2
    assert len(path) - 1 == pytest.approx(0.6 / PERIOD, abs=1)
    change = torch.cat(path).diff(dim=0).abs()
    assert (change <= PERIOD * torch.tensor(rates) * (1 + 1e-5)).all()
    shares = torch.cat(path[1:-1]) / command
    torch.testing.assert_close(shares, shares[:, :1].expand_as(shares))


def test_a_small_change_is_made_at_once() -> None:
    past, command = torch.zeros(2, 1), torch.tensor([[0.06], [0.07]])
    found = approach_command(past, command, (2.0,))
    torch.testing.assert_close(found, torch.tensor([[0.06], [0.06]]))
