"""Touchdowns of a log, and the footholds that were planned for them."""

from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

import aslip
from aslip.envs import Stack, StackEnv, default_stack, directions_stack
from aslip.envs.directions import planned_stack
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds
from aslip.log import Recorder, Recording, read
from aslip.robot import SIDES
from tests.log.helpers import MakeRecorded

_LIFT = torch.tensor([[0.0, 0.0, 800.0]])


def test_touchdowns_have_actual_and_planned_positions(
    make_recorded: MakeRecorded, tmp_path: Path, library: GaitLibrary
) -> None:
    env = make_recorded(tmp_path / "walk.mcap")
    policy = aslip.load_policy("robust")
    start = TensorDict(command=torch.full((1, 1), 1.0), phase=torch.zeros(1, 1), batch_size=1)
    env.rollout(70, policy, auto_reset=False, tensordict=env.reset(start))
    env.close()
    log = read(tmp_path / "walk.mcap")
    _check_planned(log, Footholds(library), (1.0,))
    events, truth = log["/touchdown"], log["/truth"]
    assert events["side"].tolist() in ([0, 1, 0, 1, 0], [1, 0, 1, 0, 1])
    for i, side in enumerate(events["side"]):
        k, landing = int(np.searchsorted(truth.time, events.time[i])), SIDES[side]
        assert events["x"][i] == truth[f"{landing}_foot_position_x"][k]
        assert abs(events["x"][i] - events["x_planned"][i]) < 0.1
        # it was in the air just before
        force = log["/step"][f"ground_force_{landing}_z"]
        step = int(np.searchsorted(log["/step"].time, events.time[i]))
        assert force[step] > 20 >= force[step - 3 : step].max()


def test_reset_of_an_airborne_robot_is_not_a_touchdown(
    make_recorded: MakeRecorded, tmp_path: Path
) -> None:
    """A robot lifted off the ground before a reset has not landed after it."""
    env = make_recorded(tmp_path / "a.mcap", drop=["fall", "low_reward"])
    still = torch.zeros(1, 10)
    td = env.reset()
    for _ in range(8):
        td = env.step_mdp(env.step(td.set("action", still).set("push", _LIFT)))
    assert td["truth", "ground_force"][0, :, 2].abs().max() == 0
    td = env.reset()
    for _ in range(3):
        td = env.step_mdp(env.step(td.set("action", still)))
        assert td["truth", "ground_force"][0, :, 2].max() > 20
    env.close()
    log = read(tmp_path / "a.mcap")
    assert "/touchdown" not in log.series


@pytest.mark.parametrize("policy", ["directions", "stones"])
def test_planned_footholds_are_those_of_the_gaits_of_the_stack(policy: str, tmp_path: Path) -> None:
    """The recorder finds the gaits in the stack; robots without stones follow them."""
    gaits, command = GaitLibrary.load("directions"), (0.3, 0.2, 0.4)
    stack = planned_stack(gaits) if policy == "stones" else directions_stack(gaits)
    env = _recorded(tmp_path / "a.mcap", stack)
    walk = _walk(env, tmp_path / "a.mcap", policy, command)
    _check_planned(walk, Footholds(gaits), command)
    assert walk.metadata["gaits_sha256"] == gaits.sha256


def test_motions_without_footholds_have_no_planned_ones(tmp_path: Path) -> None:
    """On the pendulum's walk, feet do not swing once per stride at rest."""
    env = _recorded(tmp_path / "a.mcap", default_stack(GaitLibrary.load("single_reference")))
    events = _walk(env, tmp_path / "a.mcap", "straight", (1.0,))["/touchdown"]
    assert np.isnan(events["x_planned"]).all()
    assert np.isfinite(events["x"]).all()


def _recorded(path: Path, stack: Stack) -> StackEnv:
    stack["recorder"] = Recorder(path)
    return aslip.make_env(seed=4, stack=stack, drop=["fall", "low_reward"])


def _walk(env: StackEnv, path: Path, policy: str, command: tuple[float, ...]) -> Recording:
    """Log of 40 policy steps."""
    start = TensorDict(command=torch.tensor([command]), phase=torch.zeros(1, 1), batch_size=1)
    env.rollout(40, aslip.load_policy(policy), auto_reset=False, tensordict=env.reset(start))
    env.close()
    return read(path)


def _check_planned(log: Recording, footholds: Footholds, command: tuple[float, ...]) -> None:
    """Compare the planned footholds of a log with those of a library."""
    events, truth = log["/touchdown"], log["/truth"]
    assert {*events["side"]} == {0, 1}
    for i, k in enumerate(np.searchsorted(truth.time, events.time)):
        side, other = SIDES[events["side"][i]], SIDES[1 - events["side"][i]]
        stance = truth.vector(f"{other}_foot_position")[k].astype(float)
        turn = truth.vector("pelvis_orientation", "wxyz")[k]
        expected = footholds.planned(side, command, stance, turn)
        np.testing.assert_allclose(
            [events["x_planned"][i], events["y_planned"][i]], expected, atol=1e-9
        )
