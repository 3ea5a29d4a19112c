"""Walks to record, and comparisons of logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from aslip.envs import StackEnv
from aslip.log import Recording
from aslip.transforms.rewards import PAPER_WEIGHTS

MakeRecorded = Callable[..., StackEnv]
Alter = Callable[[Callable[[bytearray], None]], Path]

# topic and field of the curves in every layout
VELOCITIES = {
    ("/step", "command"),
    ("/reference", "body_velocity_x"),
    ("/truth", "pelvis_velocity_x"),
    ("/estimate", "velocity_x"),
}
CURVES = {
    *VELOCITIES,
    *(("/step", f"term_{name}") for name in PAPER_WEIGHTS),
    *(("/step", f"ground_force_{side}_z") for side in ("left", "right")),
}


def run(env: StackEnv, steps: int, size: float = 0.1) -> list[TensorDict]:
    """Take steps with random actions and resets; return the tensordict of each step."""
    generator = torch.Generator().manual_seed(0)
    seen, td = [], env.reset()
    for step in range(steps):
        action = size * torch.randn(env.num_envs, 10, generator=generator)
        td["action"] = action
        if step in (3, 4):
            td["push"] = torch.tensor([[0.0, 20.0, 0.0]]).expand(env.num_envs, 3).clone()
        stepped, td = env.step_and_maybe_reset(td)
        seen.append(stepped.clone())
        td = td.exclude("push")
    return seen


def assert_subset(rest: Recording, whole: Recording) -> None:
    """Check that every message is one of the whole log."""
    for topic, series in rest.series.items():
        rows = np.searchsorted(whole[topic].time, series.time)
        np.testing.assert_array_equal(whole[topic].time[rows], series.time)
        for name, column in series.columns.items():
            if topic != "/log":  # has several lines of one time
                np.testing.assert_array_equal(column, whole[topic][name][rows], err_msg=name)
            assert set(map(str, column)) <= set(map(str, whole[topic][name]))
