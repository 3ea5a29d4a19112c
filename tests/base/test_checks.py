"""Counts, robots and states are checked before anything is written."""

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.base.checks import check_count
from aslip.envs import BatchEnv, DmControlEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.sim import SimulationPool, Simulations

NUM = 4

Maker = Callable[[int], Any]
POOLS: list[Maker] = [lambda n: SimulationPool(n, num_threads=2), lambda n: Simulations(n)]
ENVIRONMENTS: list[Maker] = [
    lambda n: BatchEnv(n, num_threads=2),
    lambda n: DmControlEnv(n),
]


def test_counts_are_whole_numbers_also_of_numpy() -> None:
    assert check_count("num", np.int64(2), 1, 2) == 2
    for value in (True, 2.0, "2", 0, -1):
        with pytest.raises(ConfigurationError, match="num must be a whole number of 1 or more"):
            check_count("num", value)
    with pytest.raises(ConfigurationError, match="num must be 2 or less, got 3"):
        check_count("num", 3, 1, 2)


@pytest.mark.parametrize("make", [*POOLS, *ENVIRONMENTS])
def test_invalid_counts_are_refused(make: Maker) -> None:
    with pytest.raises(ConfigurationError, match="must be a whole number of 1 or more, got"):
        make(2.0)  # pyright: ignore


@pytest.mark.parametrize("make", ENVIRONMENTS)
def test_numbers_of_robots_beyond_memory_are_refused(make: Maker) -> None:
    """The test limits its memory, so that an allocation would fail."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**28, hard))
    try:
        with pytest.raises(ConfigurationError, match=r"num_envs must be \d+ or less, got 10{9}"):
            make(10**9)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.mark.parametrize("make", POOLS)
@pytest.mark.parametrize("ids", [[-1], [NUM], [1, 1], [0.0]])
def test_unknown_robots_are_named(make: Maker, ids: Any) -> None:
    simulations = make(NUM)
    before = simulations.states()
    expected = rf"robots 0 to 3, got \[{ids[0]}"
    with pytest.raises(ConfigurationError, match=expected):
        simulations.reset(np.array(ids))
    mass = np.repeat(simulations.model.body_mass[None], len(ids), axis=0)
    with pytest.raises(ConfigurationError, match=expected):
        simulations.write_fields(np.array(ids), {"body_mass": mass})
    np.testing.assert_array_equal(simulations.states(), before)


@pytest.mark.parametrize("make", [*POOLS, *ENVIRONMENTS])
def test_states_of_wrong_shape_change_nothing(make: Maker) -> None:
    simulations = make(NUM)
    before = simulations.states()
    for wrong in (before[:, :-1], np.pad(before, [(0, 0), (0, 1)]), before[:-1], before[0]):
        with pytest.raises(ShapeError, match=r"states must have shape \(4, "):
            simulations.set_states(wrong + 1)
    np.testing.assert_array_equal(simulations.states(), before)
