"""`python -m aslip.network.runner` beside `python -m aslip.network.twin`, as in two terminals."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from aslip.errors import ConfigurationError, NetworkError
from aslip.network.runner.__main__ import (
    Config,
    damping_signals,
    local_address,
    main,
    make_limits,
    make_source,
)
from aslip.network.runner.commands import Datagrams
from aslip.network.runner.supervisor import Limits
from aslip.network.wire import LOOPBACK, Address
from tests.helpers import started


def test_the_runner_walks_the_twin_of_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = Limits(settle=0.3, damping=0.06)
    monkeypatch.setattr("aslip.network.runner.__main__.make_limits", lambda _: quick)
    with started([sys.executable, "-m", "aslip.network.twin", "--port", "0"]) as twin:
        assert twin.stdout is not None
        port = twin.stdout.readline().split(f"{LOOPBACK}:")[1].split(";")[0]
        run = Config(command="0.3", duration=0.9, local_port=0, patience=60.0, lockstep=True)
        main(replace(run, port=int(port), log=tmp_path / "run.mcap"))
    said = capsys.readouterr().out
    for words in (f"robot at 127.0.0.1:{port}", "walk: packets", "damping: stopped", "p99"):
        assert words in said
    main(Config(replay=tmp_path / "run.mcap"))
    assert "40 of them walked; all commands are bit-equal" in capsys.readouterr().out


def test_mistakes_are_one_line_before_the_policy_is_loaded() -> None:
    with pytest.raises(ConfigurationError, match=r"one of --command, --schedule and --listen"):
        make_source(Config(command="1", listen=0))
    with pytest.raises(ConfigurationError, match="duration must be positive"):
        make_source(Config(command="1", duration=-1.0))
    with pytest.raises(ConfigurationError, match=r"--duration needs --command or --schedule"):
        make_source(Config(listen=0, duration=5.0))
    in_use = pytest.raises(NetworkError, match=r"another program listens at 127.0.0.1:\d+")
    with Datagrams(0) as first, in_use:
        main(Config(command="1", local_port=first.port))


def test_a_signal_damps_and_a_second_one_ends() -> None:
    run: Any = SimpleNamespace(interrupted="")
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), damping_signals(run):
        # a closed terminal may send it twice
        for number in (signal.SIGHUP, signal.SIGHUP, signal.SIGUSR1):
            os.kill(os.getpid(), number)
            assert run.interrupted == "operator: SIGHUP"
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_robot_beyond_loopback_is_reached_from_one_address() -> None:
    """No socket listens at all addresses of the machine."""
    assert local_address(Address("127.0.0.5", 1), 25001) == (Address(LOOPBACK, 25001), False)
    try:
        local, beyond = local_address(Address("192.0.2.1", 25010), 25011)
    except NetworkError as error:  # a machine without a network
        assert "no route to the robot" in str(error)
    else:
        assert beyond
        assert local.port == 25011
        assert local.host != "0.0.0.0"


def test_a_robot_starts_slowly_and_a_twin_at_once() -> None:
    assert make_limits(Config()).ramp == 0.0
    assert make_limits(Config(host="10.10.10.3")).ramp == 2.0
    assert make_limits(Config(host="10.10.10.3", ramp=0.5)).ramp == 0.5
