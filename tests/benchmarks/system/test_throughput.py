"""Throughput of environments."""

import pytest
from torchrl.envs import ParallelEnv, SerialEnv

from benchmarks.system import throughput
from recipes import ppo_aslip
from tests.helpers import TINY


@pytest.mark.parametrize("parallel", [SerialEnv, pytest.param(ParallelEnv, marks=pytest.mark.slow)])
def test_throughput_reports_every_candidate(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, parallel: type
) -> None:
    """In the fast tests without other processes."""
    monkeypatch.setattr(throughput, "ParallelEnv", parallel)
    config = throughput.Config(
        num_envs=(1, 2), num_threads=(1,), rounds=1, robot_steps=1, single=1, updates=False
    )
    throughput.main(config)
    rows = [line for line in capsys.readouterr().out.splitlines() if line[:3] in ("| 1", "| 2")]
    assert len(rows) == 9 + 7
    assert all(row.endswith("% |") for row in rows)


@pytest.mark.slow
def test_throughput_reports_learning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ppo_aslip, "PRESETS", {"default": TINY})
    config = throughput.Config(num_envs=(2,), rounds=2)
    row = throughput.update_table(config).splitlines()[-1]
    assert row.startswith("| default | 64 | ")
    assert 0 < float(row.split("|")[-2].strip(" %")) < 100
