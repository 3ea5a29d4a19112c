import numpy as np
import pytest

from aslip.rom import Gait, optimize_gaits

SPEEDS = np.arange(21) / 10


@pytest.fixture(scope="session")
def gaits() -> list[Gait]:
    """The paper's 21 gaits: 0 to 2 m/s in steps of 0.1 m/s."""
    return optimize_gaits(SPEEDS.tolist())


@pytest.fixture(scope="session")
def gait(gaits: list[Gait]) -> Gait:
    """The gait at 1 m/s."""
    return gaits[10]
