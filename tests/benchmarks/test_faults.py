"""Fault injection with few faults of each kind."""

from __future__ import annotations

import json
import math
import multiprocessing
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

import aslip
from aslip.envs import BatchEnv
from aslip.errors import AslipError, ConfigurationError
from aslip.training.progress import read_progress
from aslip.training.settings import check_types
from benchmarks.faults import __main__ as suite
from benchmarks.faults import (
    files,
    runs,
    simulations,
    trainings,
)
from benchmarks.faults.kinds import KINDS
from benchmarks.faults.trainings import TINY
from recipes import ppo_aslip

FEW: dict[suite.Inject, int] = {
    simulations.bad_numbers: 8,
    runs.simulation_errors: 1,
    runs.truncations: 5,
    runs.bit_flips: 5,
    runs.lost_checkpoints: 2,
    runs.full_disks: 3,
    files.hidden_programs: 24,
    runs.bad_settings: 300,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shared folder, as several faults damage copies of the same training."""
    return tmp_path_factory.mktemp("faults")


def _survived(inject: suite.Inject, count: int, folder: Path) -> int:
    return inject(count, np.random.default_rng(0), folder)


@pytest.mark.parametrize("inject", FEW, ids=lambda inject: inject.__name__)
def test_faults_are_survived(inject: suite.Inject, folder: Path) -> None:
    """The functions describe the faults."""
    assert _survived(inject, FEW[inject], folder) == FEW[inject]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inject", "count"),
    [(runs.kills, 2), (runs.worker_kills, 2), (simulations.random_steps, 200)],
    ids=lambda f: getattr(f, "__name__", None),
)
def test_faults_of_other_processes_are_survived(
    inject: suite.Inject, count: int, tmp_path: Path
) -> None:
    assert _survived(inject, count, tmp_path) == count


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("start", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_damaged_files_are_survived(
    folder: Path, monkeypatch: pytest.MonkeyPatch, start: str
) -> None:
    """One of each kind of damage to a checkpoint; changed content that loads is detected.

    In the fast tests, the process that reads them does not import all libraries again.
    """
    context = multiprocessing.get_context(start)
    monkeypatch.setattr(multiprocessing, "get_context", lambda _: context)
    kind = KINDS["checkpoint"]
    count = len(files.damages(kind))
    assert files.damaged_files("checkpoint", count, np.random.default_rng(0), folder) == count
    kind.write(folder / "whole")
    whole = kind.load(folder / "whole")
    assert files.outcome(kind, folder / "whole", whole) == "same content"
    assert files.outcome(kind, folder / "whole", {**whole, "actor": {}}) == "other content"
    (folder / "whole").write_bytes(b"")
    assert files.outcome(kind, folder / "whole", whole) == "refused"
    broken = replace(kind, load=lambda path: [][len(str(path))])
    assert files.outcome(broken, folder / "whole", whole) == "IndexError"


def _say_nothing(*args: object, **kwargs: object) -> None:
    """Replace a check or a warning by nothing."""


@pytest.mark.parametrize(
    ("inject", "count", "target"),
    [
        (runs.bad_settings, 100, "ppo_settings.check_types"),
        (runs.truncations, 2, "aslip.training.run.torchrl_logger.warning"),
        (runs.full_disks, 2, "aslip.training.run.torchrl_logger.warning"),
    ],
)
def test_unsurvived_faults_are_not_counted(
    folder: Path, monkeypatch: pytest.MonkeyPatch, inject: suite.Inject, count: int, target: str
) -> None:
    monkeypatch.setattr(target, _say_nothing)
    assert _survived(inject, count, folder) < count


class Spoiling(Transform):
    """Put NaN into one robot's state at three policy steps."""

    def __init__(self) -> None:
        super().__init__()
        self._taken = 0

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        self._taken += 1
        base: Any = self.parent
        while not isinstance(base, BatchEnv):
            base = base.base_env
        if self._taken in (8, 12, 19):
            states = base.states()
            states[self._taken % base.num_envs, 3] = math.nan
            base.set_states(states)
        return next_tensordict


def test_training_continues_after_divergence(tmp_path: Path) -> None:
    """Three NaN states of one robot cause three divergences, and all numbers stay finite."""
    config = replace(TINY, out=tmp_path / "run", total_steps=128)
    trainings.train(config, make_collector=runs.faulty_collector(Spoiling))
    progress = read_progress(config.out)
    assert progress["divergences"] == [2, 3]
    for name, column in progress.items():
        assert "eval" in name or all(map(math.isfinite, column)), name


# ---------------------------------------------------------------------- settings


@pytest.mark.parametrize("field", fields(ppo_aslip.Config), ids=lambda field: field.name)
def test_error_names_setting_of_wrong_type(field: Any) -> None:
    rng = np.random.default_rng(len(field.name))
    for _ in range(20):
        value = runs.bad_value(field.name, rng)
        with pytest.raises(ConfigurationError, match=field.name):
            replace(TINY, **{field.name: value})


def test_accepts_settings_of_right_types() -> None:
    for preset in ppo_aslip.PRESETS.values():
        check_types(preset)
    check_types(replace(TINY, gamma=1, learning_rate=np.float64(1e-3), out=Path()))


@pytest.mark.parametrize("name", ["num_envs", "seed", "num_threads", "backend", "reward_on"])
def test_make_env_refuses_invalid_settings(name: str) -> None:
    settings: dict[str, Any] = {}
    none = () if name == "seed" else (None,)
    for settings[name] in (*none, "", "8", b"8", [], {}, 2.5, -1, math.nan, math.inf, object()):
        with pytest.raises(AslipError, match=name):
            aslip.make_env(**settings)


# -------------------------------------------------------------------------- tools


def test_identical_compares_nested_states() -> None:
    """The other tests depend on this comparison."""
    state = trainings.Holder({"a": (1, [2.0]), "t": np.float64(3)}).state_dict()
    assert trainings.identical(state, {"a": (1, [2.0]), "t": 3.0})
    for other in ({"a": (1, [2.5]), "t": 3.0}, {"a": (1, [2.0])}, {"a": (1, []), "t": 3.0}):
        assert not trainings.identical(state, other)


def test_command_prints_table_and_writes_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    none: dict[str, Any] = {
        field.name: 0 for field in fields(suite.Config) if isinstance(field.default, int)
    }
    config = suite.Config(
        **{**none, "bad_numbers": 2, "bad_settings": 5, "report": tmp_path / "f.json"}
    )
    table = suite.main(config)
    assert table["setting of a wrong type or out of range"] == {"injected": 5, "survived": 5}
    assert len(table) == 2
    assert "| 5 | 5 |" in capsys.readouterr().out
    assert json.loads((tmp_path / "f.json").read_text()) == {"seed": 0, "faults": table}
