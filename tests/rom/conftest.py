import pytest

from aslip.rom import Gait, optimize_gaits

SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0)


@pytest.fixture(scope="session")
def gaits() -> list[Gait]:
    """Five of the paper's gaits, from 0 to 2 m/s."""
    return optimize_gaits(SPEEDS)


@pytest.fixture(scope="session")
def gait(gaits: list[Gait]) -> Gait:
    """The gait at 1 m/s."""
    return gaits[2]
