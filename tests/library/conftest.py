"""Small library to damage, and a user-defined motion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aslip.library import GaitLibrary
from aslip.library.table import ARRAYS
from aslip.rom import Angle, MotionSample, PendulumWalk, Track
from tests.helpers import MADE_BY


class Shuffle:
    """User-defined motion without a base class: a pendulum walk that drifts sideways.

    The toes point outwards, and the command has two axes, forward and sideways.
    """

    def __init__(self, forward: float, sideways: float, toes: float = 0.1) -> None:
        self.command = np.array([forward, sideways])
        self.forward, self.sideways = forward, sideways
        self.stride = 0.8
        self.toes = toes

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Sample a forward walk, moved sideways at the commanded speed."""
        walk = PendulumWalk(speed=self.forward, stride=self.stride).sample(phase)
        drift = np.multiply.outer(phase * self.stride, [0.0, self.sideways, 0.0])
        rate = np.array([0.0, self.sideways, 0.0])
        return MotionSample(
            body=Track(walk.body.position + drift, walk.body.velocity + rate),
            feet=Track(walk.feet.position + drift[:, None], walk.feet.velocity + rate),
            ground_force=walk.ground_force,
            heading=Angle.zeros(len(phase)),
            foot_heading=np.tile([self.toes, -self.toes], (len(phase), 1)),
        )


@pytest.fixture(scope="session")
def small(library: GaitLibrary) -> GaitLibrary:
    """Library of two gaits with eight samples each."""
    table = library.table
    rows = {name: getattr(table, name)[[5, 10]] for name in ARRAYS}
    thinned = {name: v[:, ::16] if v.ndim > 1 else v for name, v in rows.items()}
    table = replace(table, axes=(library.speeds[[5, 10]],), **thinned)
    return GaitLibrary([library.motions[5], library.motions[10]], table, made_by=MADE_BY)


@pytest.fixture
def file(small: GaitLibrary, tmp_path: Path) -> Path:
    """File of the small library."""
    path = tmp_path / "gaits.npz"
    small.save(path)
    return path
