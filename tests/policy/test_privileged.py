"""The critic sees truth and dynamics, and is as symmetric as the robot."""

from typing import Any

import torch
from tensordict import TensorDict

import aslip
from aslip.envs import EPISODE_ENDS, walking_stack
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    make_actor,
    make_privileged_critic,
    observation_mirror,
    privileged_table,
    update_normalizers,
)
from aslip.policy.privileged import PRIVILEGED_SIGNS
from aslip.transforms import OBSERVATION_TABLE
from aslip.transforms.observation import join_entries
from tests.library.bent import symmetric_library

SIZES = (64, 18)


def _data(num: int = 5) -> TensorDict:
    entries = {"observation": torch.randn(num, 64), "privileged": torch.randn(num, 18)}
    return TensorDict(entries, batch_size=num)


def test_a_value_depends_on_privileged_entries_but_not_on_the_side() -> None:
    shape, names = PolicyShape(symmetric=True), ["slope", "time"]
    known: Any = {"dynamics": names[:1], "numbers": [("plan", names[1])]}
    critic = make_privileged_critic(RunningNormalizer(64), shape, **known, scale=10.0)
    data, table = _data(), (*OBSERVATION_TABLE, *privileged_table(**known))
    signs = {**PRIVILEGED_SIGNS, **dict.fromkeys(names, (1.0,))}
    mirror = observation_mirror(table, signs)
    image = mirror(torch.cat([data["observation"], data["privileged"]], dim=-1)).split(SIZES, -1)
    mirrored = TensorDict(dict(zip(data.keys(), image, strict=True)), batch_size=5)
    value = critic(data.clone())["state_value"]
    torch.testing.assert_close(critic(mirrored)["state_value"], value)
    other = critic(data.clone().update({"privileged": data["privileged"] + 1.0}))
    assert (other["state_value"] - value).abs().min() > 1e-4


def test_mirrored_walks_have_mirrored_truths() -> None:
    """Robot 1 starts half a stride later with sideways speed and yaw rate reversed."""
    env = aslip.make_env(
        stack=walking_stack(symmetric_library()),
        num_envs=2,
        num_threads=1,
        drop=EPISODE_ENDS,
        seed=0,
    )
    command, phase = [[0.5, 0.15, 0.6], [0.5, -0.15, -0.6]], [[0.2], [0.7]]
    start = {"command": torch.tensor(command), "phase": torch.tensor(phase)}
    td = env.reset(TensorDict(start, batch_size=2))
    table = privileged_table([])
    mirror = observation_mirror(table, PRIVILEGED_SIGNS)
    for _ in range(3):
        seen = join_entries(td, table)
        torch.testing.assert_close(mirror(seen[1]), seen[0], atol=3e-3, rtol=0)
        td = env.step(td.set("action", torch.zeros(2, 10)))["next"]


def test_each_normaliser_counts_a_batch_once() -> None:
    shared = RunningNormalizer(64)
    critic = make_privileged_critic(shared, dynamics=["slope", "mass"])
    data = _data()
    update_normalizers([make_actor(shared), critic], data)
    assert (shared.count == 5).all()
    (own,) = (m for m in critic.modules() if isinstance(m, RunningNormalizer) and m is not shared)
    assert (own.count == 5).all()
    torch.testing.assert_close(own.mean, data["privileged"].double().mean(0))
