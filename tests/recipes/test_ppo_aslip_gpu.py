"""The preset gpu trains on MuJoCo Warp; here on its CPU device."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.training.progress import read_progress
from recipes import ppo_aslip
from recipes.ppo_settings import PRESETS


def test_a_training_on_a_device_resumes(tmp_path: Path) -> None:
    tiny = replace(
        PRESETS["gpu"], device="cpu", num_envs=8, samples=64, minibatch=32, epochs=1,
        total_steps=64, eval_interval=10**6, eval_steps=2, out=tmp_path,
    )  # fmt: skip
    ppo_aslip.main(tiny)
    results = ppo_aslip.main(replace(tiny, total_steps=128, resume=True))
    assert len(results) == 21
    assert read_progress(tmp_path)["step"] == [64.0, 128.0]


def test_without_a_gpu_the_preset_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigurationError, match="no GPU for device 'cuda'"):
        ppo_aslip.main(replace(PRESETS["gpu"], out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()
