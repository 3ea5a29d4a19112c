"""Simulations that diverge are reported and reset, and do not affect others."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dm_control.rl.control import PhysicsError

from aslip.envs import BipedPhysics
from aslip.robot import model
from aslip.sim import SimulationPool, Simulations
from tests.sim.batches import assert_rows_equal, random_targets

Break = Callable[[Simulations, np.ndarray], None]


def _nan_target(simulations: Simulations, target: np.ndarray) -> None:
    target[1, 3] = np.nan


def _infinite_position(simulations: Simulations, target: np.ndarray) -> None:
    simulations.batch.bind("qpos")[1, 9] = np.inf


def _nan_velocity(simulations: Simulations, target: np.ndarray) -> None:
    simulations.batch.bind("qvel")[1, 4] = np.nan


def _huge_velocity(simulations: Simulations, target: np.ndarray) -> None:
    simulations.batch.bind("qvel")[1, 8] = 1e12


def _mujoco_error(simulations: Simulations, target: np.ndarray) -> None:
    """Make MuJoCo raise an error in the tenth substep of one simulation."""
    kinds = simulations.batch.expand("eq_type")
    original, calls = simulations.batch.step, [0]

    def step(*args: Any, **kwargs: Any) -> None:
        calls[0] += 1
        kinds[1, 0] = 99 if calls[0] == 10 else 0
        try:
            original(*args, **kwargs)
        finally:
            kinds[1, 0] = 0

    simulations.batch.step = step


BREAKS: list[Break] = [
    _nan_target,
    _infinite_position,
    _nan_velocity,
    _huge_velocity,
    _mujoco_error,
]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("damage", BREAKS, ids=lambda f: f.__name__.strip("_"))
def test_divergence_affects_one_simulation_only(damage: Break) -> None:
    """A diverged simulation is reported, counted and reset to standing."""
    broken, whole = Simulations(3, num_threads=1), Simulations(3, num_threads=1)
    targets = random_targets(3, 6)
    for target in targets[:2]:
        broken.advance(target)
        whole.advance(target)
    target = targets[2].copy()
    damage(broken, target)
    assert broken.advance(target).tolist() == [False, True, False]
    assert not whole.advance(targets[2]).any()
    assert (broken.divergences, whole.divergences) == (1, 0)
    assert_rows_equal(broken, whole, [0, 2])

    fresh = Simulations(3, num_threads=1)
    assert_rows_equal(broken, fresh, [1])

    # all three continue; the restarted one equals a new simulation
    if damage is _mujoco_error:
        del broken.batch.step
    for target in targets[3:]:
        assert not broken.advance(target).any()
        whole.advance(target)
        fresh.advance(target)
    assert_rows_equal(broken, whole, [0, 2])
    assert_rows_equal(broken, fresh, [1])
    assert broken.divergences == 1


def test_simulations_that_diverge_write_one_warning_and_no_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Also in threads, and in dm_control, which has a handler of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(model, "_warned", False)
    simulations = SimulationPool(4, num_threads=2)
    assert all(simulations.advance(np.full((4, 10), np.nan)).all() for _ in range(2))
    physics = BipedPhysics.load()
    physics.data.qvel[:] = np.nan
    with pytest.raises(PhysicsError):
        physics.step()
    (record,) = caplog.records
    assert "The simulation is unstable" in record.message
    assert not list(tmp_path.iterdir())
    assert "WARNING" not in capfd.readouterr().err
