"""Reset requests override what transforms draw."""

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.errors import AslipError, ConfigurationError, ShapeError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.sim.course import pattern
from tests.helpers import BACKENDS, STANDING, MakeEnv


def _start(height: float = 1.347) -> TensorDict:
    """Two robots in the air, moving up."""
    qpos, qvel = STANDING.repeat(2, 1), torch.zeros(2, 32, dtype=torch.float64)
    qpos[:, 2], qvel[:, 2] = height, 0.5
    return TensorDict(qpos=qpos, qvel=qvel, batch_size=2)


def _values(name: str, *values: float) -> TensorDict:
    return TensorDict({name: torch.tensor(values)[:, None]}, batch_size=2)


def _request(**groups: TensorDict) -> TensorDict:
    return TensorDict(groups, batch_size=2)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("drop", [[], ["start"]])
def test_robots_start_in_the_requested_state(make: MakeEnv, backend: str, drop: list[str]) -> None:
    start = _start()
    request = _request(initial=start.clone())
    td = make(backend, num_envs=2, drop=drop).reset(request)
    for name in ("qpos", "qvel"):
        torch.testing.assert_close(td["truth", name], start[name], rtol=0, atol=0)
        torch.testing.assert_close(request["initial", name], start[name], rtol=0, atol=0)


def test_positions_come_from_the_reference_if_only_velocities_are_requested(
    make: MakeEnv, library: GaitLibrary
) -> None:
    start = _start().select("qvel")
    given = {"command": torch.ones(2, 1), "phase": torch.full((2, 1), 0.25)}
    request = _request(initial=start).update(given)
    td = make(num_envs=2).reset(request)
    qpos, _ = library.initial_state(given["phase"], given["command"])
    torch.testing.assert_close(td["truth", "qpos"], qpos, rtol=0, atol=1e-12)
    torch.testing.assert_close(td["truth", "qvel"], start["qvel"], rtol=0, atol=0)
    assert list(request["initial"].keys()) == ["qvel"]


@pytest.mark.parametrize("backend", BACKENDS)
def test_robots_have_the_requested_dynamics(make: MakeEnv, backend: str) -> None:
    """And stones, which stay without a request, too."""
    env = make(backend, num_envs=2)
    stones = torch.tensor(pattern("up").stones).repeat(2, 1, 1)
    stones[1, 1:] = torch.nan
    course = TensorDict(stones=stones, batch_size=2)
    env.reset(_request(dynamics=_values("mass", 1.5, 0.8), course=course))
    assert env.base_env.dynamics["mass"].tolist() == pytest.approx([1.5, 0.8])
    env.reset()
    assert env.base_env.dynamics["mass"].tolist() == pytest.approx([1.5, 0.8])
    np.testing.assert_array_equal(env.base_env.stones, stones)


@pytest.mark.parametrize("drop", [[], ["start"]])
def test_entries_of_an_ending_episode_are_not_requests(make: MakeEnv, drop: list[str]) -> None:
    """A partial reset of TorchRL passes the whole old tensordict with a mask."""
    env = make(num_envs=2, drop=drop)
    td = env.reset(_request(initial=_start(), dynamics=_values("mass", 1.5, 0.8)))
    assert "initial" in td
    env.base_env.set_dynamics({"mass": 1.0})
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert td["truth", "qpos"][0, 2] < 1.1
    assert td["truth", "qpos"][1, 2] == 1.347
    assert env.base_env.dynamics["mass"].tolist() == [1.0, 1.0]


def test_partial_resets_in_a_row_keep_the_entries_of_the_others(make: MakeEnv) -> None:
    """Requests with nothing but a mask, as collectors send them."""
    env = make(num_envs=2)
    td = env.reset()
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    first, second = (
        env.reset(TensorDict(_reset=torch.tensor(mask), batch_size=2))
        for mask in ([[True], [False]], [[False], [True]])
    )
    assert first["step_count"].flatten().tolist() == [0, 3]
    assert second["step_count"].flatten().tolist() == [0, 0]
    for key in ("command", "phase", ("truth", "qpos"), ("reference", "body_position")):
        assert torch.equal(second[key][0], first[key][0])


@pytest.mark.parametrize(
    ("request_", "error", "message"),
    [
        ({"initial": TensorDict(qpo=STANDING.repeat(2, 1), batch_size=2)}, UnknownNameError, "qpo"),
        ({"dynamics": _values("mas", 1.0, 1.0)}, UnknownNameError, "did you mean 'mass'"),
        ({"dynamics": _values("mass", 1.0, 50.0)}, ConfigurationError, "mass of robot 1"),
        ({"initial": torch.zeros(2, 35)}, ShapeError, "initial must be a TensorDict"),
        ({"dynamics": torch.ones(2, 1)}, ShapeError, "dynamics must be a TensorDict"),
        (
            {"initial": TensorDict(qpos=torch.zeros(2, 34), batch_size=2)},
            ShapeError,
            r"initial qpos must have shape \(2, 35\)",
        ),
    ],
)
def test_invalid_requests_are_refused(
    make: MakeEnv, request_: dict[str, Any], error: type[AslipError], message: str
) -> None:
    env = make(num_envs=2)
    before = env.base_env.states()
    with pytest.raises(error, match=message):
        env.reset(TensorDict(request_, batch_size=2))
    assert (env.base_env.states() == before).all()
