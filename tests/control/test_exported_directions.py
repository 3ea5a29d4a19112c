"""Exported policies that walk in all directions along a path, and take stand commands."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aslip.control import Controller
from aslip.control.contract import TOLERANCE
from aslip.control.export import export_policy
from aslip.control.exported import ExportedController
from aslip.errors import ConfigurationError, UnknownNameError
from tests.control.helpers import estimate, recurrent_controller, standing_packet


@pytest.fixture(scope="module")
def recurrent() -> Controller:
    return recurrent_controller()


@pytest.fixture(scope="module")
def turning(recurrent: Controller, tmp_path_factory: pytest.TempPathFactory) -> ExportedController:
    return export_policy(recurrent, tmp_path_factory.mktemp("gru") / "gru.onnx")


def test_hidden_states_and_filtered_commands_are_part_of_the_graph(
    recurrent: Controller, turning: ExportedController
) -> None:
    assert turning.contract.feedback["memory"] == "last_memory"
    assert turning.verify() <= TOLERANCE
    row = estimate(turning.contract.golden_trace()["estimate"][0])
    state = turning.start(row, 0.5)
    for name in ("memory", "filtered_command"):
        forgetful = {**state.entries, name: np.zeros_like(state.entries[name])}
        _, remembered = turning.step(state, row)
        _, forgotten = turning.step(replace(state, entries=forgetful), row)
        assert np.abs(remembered - forgotten).max() > 1e-4, name


def test_the_golden_trace_covers_stops_and_starts(
    turning: ExportedController,
) -> None:
    contract = turning.contract
    assert turning.stands
    assert contract.metadata["command_names"] == "command,stand"
    assert contract.feedback["mode"] == "last_mode"
    entries = turning._replayed(contract.golden_trace())
    modes = np.array([step["mode"].item() for step in entries])
    assert set(modes) == {0, 1, 2, 3}
    for before, after in ((1, 2), (2, 3), (3, 0)):
        assert ((modes[:-1] == before) & (modes[1:] == after)).any()
    errors = np.concatenate([step["path_error"] for step in entries])
    assert errors.std(axis=0).min() > 0.05


@pytest.mark.parametrize("mode", ["estimates", "packets"])
def test_motor_targets_are_those_of_the_controller(
    recurrent: Controller, turning: ExportedController, mode: str
) -> None:
    """With new headings, lost estimates, a restart into standing, and stand commands that hold."""
    rng = np.random.default_rng(2)
    rows: list[Any] = [
        standing_packet() + 0.01 * rng.standard_normal((1, 10, 42)) for _ in "x" * 40
    ]
    if mode == "estimates":
        rows = [estimate(row) for row in turning.contract.golden_trace()["estimate"][:40]]
    stands = {3: 1.0, 20: 0.0, 30: 1.0}
    both: list[Any] = [
        one.start(rows[0], [0.1, 0.0, 0.3], heading=0.2) for one in (recurrent, turning)
    ]
    modes = set()
    for i, row in enumerate(rows[1:]):
        given: dict[str, Any] = {"stand": stands.get(i), "heading": 1.0 if i == 9 else None}
        given["command"] = [0.1, 0.0, 0.3 - 0.02 * i]
        got = None if i == 12 else row
        if i == 32:  # a restart into standing
            again = {"command": [0.1, 0.0, 0.3], "stand": 1.0, "phase": 0.3}
            theirs, ours = (one.start(row, **again) for one in (recurrent, turning))
        else:
            theirs, _ = recurrent.step(both[0], got, **given)
            ours, _ = turning.step(both[1], got, **given)
        np.testing.assert_allclose(ours.motor_target, theirs.motor_target, rtol=0, atol=2e-6)
        heading = theirs.tensordict.get("heading", None)
        if heading is not None:
            np.testing.assert_allclose(ours.entries["heading"], heading, rtol=0, atol=1e-7)
        error = theirs.tensordict["odometry", "path_error"].numpy()
        np.testing.assert_allclose(ours.entries["path_error"], error, rtol=0, atol=1e-6)
        assert ours.entries["mode"].item() == theirs.tensordict["mode"].item()
        both = [theirs, ours]
        modes.add(ours.entries["mode"].item())
    assert 2 in modes


def test_places_that_an_estimate_lacks_are_named(
    recurrent: Controller, turning: ExportedController
) -> None:
    row = estimate(turning.contract.golden_trace()["estimate"][0])
    del row["position"]
    with pytest.raises(ConfigurationError, match="estimates need 'position'"):
        turning.start(row)
    with pytest.raises(UnknownNameError, match="estimates lack 'position'"):
        recurrent.start(row)
