"""Progress bar of a training: width, counts, and time left."""

import io
import os
import re

import pytest
import torch
from tensordict import TensorDict

from aslip.training import progress as progress_module
from aslip.training.progress import Progress

_SAMPLES = 2048


def _batch() -> TensorDict:
    ends = torch.ones(1, _SAMPLES, 1)
    after = {"done": ends.bool(), "step_count": 350 * ends, "episode_reward": 321 * ends}
    return TensorDict({"next": after}, batch_size=(1, _SAMPLES))


def test_the_bar_fits_80_columns_never_goes_back_and_knows_the_pace_of_the_last_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At last it is full; a training that got faster is not judged by its first minutes."""
    now = [0.0]
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: now[0])
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "fileno", lambda: 2)
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((80, 24)))
    batch, count = _batch(), 50
    with Progress(count * _SAMPLES - 5, _SAMPLES) as progress:
        for i, _ in enumerate(progress.watch(batch for _ in range(count))):
            now[0] += 4000.0 if i < 20 else 6.0
            progress.add(batch)
        assert progress.pace == pytest.approx(_SAMPLES / 6)
        assert progress.finished
    lines = [line for line in re.split(r"[\r\n]+", terminal.getvalue()) if line.strip()]
    assert max(map(len, lines)) == 79  # tqdm leaves one free
    percents = [int(line.partition("%")[0]) for line in lines]
    assert percents == sorted(percents)
    assert (percents[0], percents[-1]) == (0, 100)
    assert lines[1].endswith("| 2.05k/102k, 2 days, 6:26:40 left, 1/s, length 350, return 321")
    # the update 10 updates ago began the last minute, and 19 are left
    assert ", 0:01:54 left, 341/s, " in lines[31]
    assert lines[-1].endswith("| 102k/102k, 0:00:00 left, 341/s, length 350, return 321")
