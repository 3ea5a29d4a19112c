"""The recipe that walks a policy: table, log, viewer and film."""

import contextlib
import re
import signal
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from aslip.errors import AslipError, ConfigurationError, SpeedOutOfRangeError, one_line_errors
from aslip.log import read, replay
from aslip.log.__main__ import main as log_main
from aslip.robot import CASSIE
from recipes import walk
from tests.show.test_film import decoded_film, leaves_pipes

_config = partial(walk.Config, policy="straight")


def test_walk_follows_the_schedule_and_is_logged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "walk.mcap"
    walk.main(
        _config(command="0:0.5,0.9:1.0", duration=1.8, push=("0.3:0,30,0:0.06",), log=path, seed=3)
    )
    table = capsys.readouterr().out
    assert "| 0 | 0.50 |" in table
    assert "| 0.9 | 1.00 |" in table
    log = read(path)
    assert "the robot walked for 1.80 s" in table
    assert re.search(r"^policy straight: trained for \d+ policy steps$", table, re.MULTILINE)
    assert f"wrote {path}" in table
    assert f"python -m aslip.log replay --verify {path}" in table
    assert len(log["/step"]) == 60
    np.testing.assert_array_equal(log["/step"]["command"], [0.5] * 30 + [1.0] * 30)
    np.testing.assert_array_equal(np.flatnonzero(log["/step"]["push_y"]), [10, 11])
    assert '"command": "0:0.5,0.9:1.0"' in log.attachments["config.json"].decode()
    assert "policy.zip" in log.attachments
    assert log_main(["replay", "--verify", str(path)]) == 0


def test_walks_on_both_backends_and_on_the_true_state(tmp_path: Path) -> None:
    for name, settings in {"dm": {"backend": "dm_control"}, "truth": {"truth": True}}.items():
        path = tmp_path / f"{name}.mcap"
        walk.main(_config(command="0.5", duration=0.3, log=path, **settings))  # pyright: ignore
        assert replay(path).equal
    estimate, truth = (read(tmp_path / "truth.mcap")[topic] for topic in ("/estimate", "/truth"))
    np.testing.assert_array_equal(estimate["height"], truth["pelvis_position_z"])


def test_fall_ends_the_walk_with_a_complete_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fall.mcap"
    walk.main(_config(command="0.5", push=("0.2:0,2500,0:0.3",), log=path))
    output = capsys.readouterr().out
    assert f"the robot fell after {0.03 * len(read(path)['/step']):.2f} s" in output
    assert f"wrote {path}" in output
    assert "terminated" in read(path)["/log"]["msg"][-1]
    assert replay(path).equal


@pytest.mark.parametrize(
    ("settings", "error", "names"),
    [
        ({"command": "0:3.0"}, SpeedOutOfRangeError, "speed 3 m/s"),
        ({"push": ("1",)}, ConfigurationError, "push is"),
        ({"duration": -1.0}, ConfigurationError, "duration"),
        ({"push": ("9:0,5,0",), "duration": 2.0}, ConfigurationError, "9 s .*, from 0 to 2 s"),
        ({"push": ("1.05:0,5,0", "1:5,0,0")}, ConfigurationError, "1.05 s .*begins before"),
        ({"live": True, "viewer": True}, ConfigurationError, "--live"),
        ({"live": True, "command": "0:0.5,4:stand"}, ConfigurationError, "got the schedule"),
        ({"steps_per_frame": 0}, ConfigurationError, "steps per frame.* 0"),
        ({"log": Path(".")}, ConfigurationError, "exists"),
        ({"video": Path("walk.mp4"), "camera": "nose"}, ConfigurationError, "nose"),
        ({"video": Path("walk.mp4"), "width": 10**5}, ConfigurationError, "100000"),
    ],
)
def test_invalid_settings_are_refused_before_anything_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    settings: dict,
    error: type[AslipError],
    names: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=names):
        walk.main(_config(**{"log": Path("walk.mcap"), **settings}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_walk_stopped_by_a_signal_leaves_a_complete_log(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    status: int,
) -> None:
    path = tmp_path / "walk.mcap"
    step, left = walk.Walker.step, [40]

    def stopped(*args: Any, **settings: Any) -> Any:
        left[0] -= 1
        if left[0] == 0:
            signal.raise_signal(number)
        return step(*args, **settings)

    monkeypatch.setattr(walk.Walker, "step", stopped)
    with pytest.raises(SystemExit) as info, one_line_errors():
        walk.main(_config(command="0.5", duration=1000.0, log=path))
    assert info.value.code == status
    output = capsys.readouterr().out
    assert "walked for 1.17 s" in output
    assert f"wrote {path}" in output
    assert [p.name for p in tmp_path.iterdir()] == ["walk.mcap"]
    assert log_main(["check", str(path)]) == 0


def test_the_viewer_shows_every_step_in_real_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown, waits = [], []

    class Window(contextlib.nullcontext):
        cam, user_scn = SimpleNamespace(), None
        lock = contextlib.nullcontext
        is_running = staticmethod(lambda: True)
        sync = staticmethod(lambda: shown.append(1))

    class Pacer:
        def __init__(self, period: float) -> None:
            assert period == CASSIE.policy_period

        def wait(self) -> None:
            waits.append(len(shown))

    monkeypatch.setenv("DISPLAY", ":0")
    viewer = SimpleNamespace(launch_passive=lambda *_, **__: Window())
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr("mujoco.viewer", viewer, raising=False)
    monkeypatch.setattr("aslip.show.viewer.Pacer", Pacer)
    walk.main(_config(command="0.5", duration=0.3, viewer=True))
    assert waits == list(range(1, 11))


# ---------------------------------------------------------------------- films


@leaves_pipes
@pytest.mark.usefixtures("pictures")
def test_a_walk_can_be_filmed(tmp_path: Path) -> None:
    path = tmp_path / "walk.mp4"
    size: dict[str, Any] = {"width": 160, "height": 120}
    walk.main(_config(command="1.0", duration=0.15, video=path, steps_per_frame=2, **size))
    about, decoded = decoded_film(path)
    assert about["size"] == (160, 120)
    assert about["fps"] * 2 == pytest.approx(1 / CASSIE.policy_period, rel=1e-3)
    assert len(decoded) == 3
    assert decoded.std() > 10  # the picture is not uniform
