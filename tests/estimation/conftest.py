"""A walk, and its estimates from good packets."""

import numpy as np
import pytest

from tests.estimation.walks import Walk, follow


@pytest.fixture(scope="package")
def walk() -> Walk:
    return Walk()


@pytest.fixture(scope="package")
def sound(walk: Walk) -> list[dict[str, np.ndarray]]:
    return follow(walk)
