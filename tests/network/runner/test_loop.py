"""Runs against the twin over loopback: lockstep, real time, damping, logs and their replay."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from aslip.control import Controller
from aslip.control.estimates import standing_estimate
from aslip.errors import ConfigurationError, FileDamagedError, NetworkError
from aslip.library import GaitLibrary, Schedule
from aslip.log import read
from aslip.network.runner.commands import Datagrams, Scheduled
from aslip.network.runner.load import Loaded, load, warm_up
from aslip.network.runner.loop import LATE, Run, Tally, run_lockstep, run_real_time, take_priority
from aslip.network.runner.readings import SensorReadings, StateReadings
from aslip.network.runner.record import RunLog, replay, run_metadata
from aslip.network.runner.supervisor import Limits, Request, Stage, Supervisor
from aslip.network.twin import Guide, TwinRobot, mujoco_engine, serve_lockstep
from aslip.network.wire import (
    CASSIE_OUT,
    PD_IN,
    STATE_OUT,
    Arrival,
    Endpoint,
    MotorCommand,
    command_to_pd_in,
    estimate_to_state_out,
    pd_in_to_command,
    state_out_to_estimate,
)
from aslip.planning import Planner
from aslip.robot import CASSIE
from aslip.sim.course import stairs
from tests.network.twin.sockets import robot_socket, serving, socket_to

QUICK = Limits(settle=0.09, damping=0.06)
WALK = 1.02


@pytest.fixture(scope="module")
def loaded() -> Loaded:
    return load("straight")


@contextmanager
def connected(serve: Any, *arguments: Any, raw: bool = False) -> Iterator[Endpoint]:
    """Socket to a robot that `serve(*arguments, socket, stop)` plays in a thread."""
    with serving(serve, *arguments, raw=raw) as server, socket_to(server.local, raw) as endpoint:
        yield endpoint


def make_run(
    loaded: Loaded, *, duration: float = 1e6, log: RunLog | None = None
) -> tuple[Run, list[str]]:
    """Run at 0.5 m/s, and the lines that it prints."""
    supervisor = Supervisor(loaded.controller, QUICK)
    said: list[str] = []
    source = Scheduled(Schedule.parse("0.5"), duration)
    return Run(supervisor, StateReadings(), source, log=log, say=said.append), said


@pytest.fixture(scope="module")
def lockstep(loaded: Loaded, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A logged walk of the twin in lockstep, with a stop."""
    path, twin = tmp_path_factory.mktemp("logs") / "run.mcap", TwinRobot()
    metadata = run_metadata("straight", StateReadings(), QUICK)
    log = RunLog(path, STATE_OUT, loaded.files, metadata)
    run, said = make_run(loaded, duration=WALK, log=log)
    with connected(serve_lockstep, twin) as endpoint:
        run_lockstep(run, endpoint)
        counters = endpoint.link.counters
    run.close()
    return SimpleNamespace(path=path, twin=twin, run=run, said=said, counters=counters)


def test_a_run_walks_stops_and_damps(lockstep: SimpleNamespace) -> None:
    said = "\n".join(lockstep.said)
    for words in ("walk: packets arrive", "stop: stopped by", "damping: stopped by"):
        assert words in said
    assert lockstep.run.supervisor.reading.estimate["height"] > 0.7
    walked = round((WALK + QUICK.settle) / CASSIE.policy_period)
    assert len(lockstep.run.tally.work) == walked + 2
    assert lockstep.run.walked == pytest.approx(WALK + QUICK.settle)
    assert lockstep.twin.ticks == lockstep.counters.accepted


def test_commands_of_a_run_are_those_of_the_controller(
    lockstep: SimpleNamespace, loaded: Loaded
) -> None:
    """A twin in this process, without supervisor, sockets and loop."""
    twin, controller = TwinRobot(), Controller("straight", GaitLibrary.load())
    record = twin.tick(PD_IN.zeros())
    state = controller.start(state_out_to_estimate(record), 0.5, heading=0.0)
    tick = read(lockstep.path)["/tick"]
    names = [f"position_{motor}" for motor in CASSIE.motor_names]
    for k in range(10):
        logged = np.array([tick[name][k] for name in names])
        np.testing.assert_array_equal(logged, state.motor_target[0].numpy())
        for _ in range(CASSIE.substeps):
            record = twin.tick(command_to_pd_in(state.motor_target[0].numpy()))
        state, _ = controller.step(state, state_out_to_estimate(record), 0.5)


def test_a_log_replays_bit_for_bit(lockstep: SimpleNamespace, tmp_path: Path) -> None:
    made: list[list[str]] = []

    def make(files: list[Path]) -> Any:
        made.append([file.name for file in files])
        return load(*files).controller

    result = replay(lockstep.path, make, tmp_path)
    assert made == [["policy.zip", "library.npz"]]
    assert (result.different, result.walked) == (0, len(lockstep.run.tally.work) - 2)
    read(lockstep.path)


def test_a_replay_finds_another_controller(lockstep: SimpleNamespace, tmp_path: Path) -> None:
    other = Controller("straight", GaitLibrary.load(), motor_lead=0.0)
    result = replay(lockstep.path, lambda _: other, tmp_path)
    assert (result.different, result.first) == (result.walked, 0.0005)


def test_other_logs_are_not_replayed(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    log = RunLog(path, STATE_OUT, {}, run_metadata("straight", StateReadings(), QUICK))
    log.finish({})
    with pytest.raises(FileDamagedError, match="no log of a run over the network"):
        replay(path, cast("Any", None), tmp_path)
    with pytest.raises(ConfigurationError, match="exists"):
        RunLog(path, STATE_OUT, {}, {})


@pytest.mark.parametrize(
    ("files", "more", "message"),
    [
        ({"../evil": b"x"}, {}, "its files are"),
        ({"policy.onnx": b"x"}, {"limits/colour": "1"}, "colour"),
    ],
)
def test_logs_of_strangers_write_nothing_elsewhere(
    tmp_path: Path, files: dict[str, bytes], more: dict[str, str], message: str
) -> None:
    (tmp_path / "within").mkdir()
    metadata = {**run_metadata("straight", StateReadings(), QUICK), **more}
    log = RunLog(tmp_path / "run.mcap", STATE_OUT, files, metadata)
    log.tick(0, Request(), Stage.WALK, MotorCommand(*np.zeros((5, 10))), None, (0.0, 0.0))
    log.finish({})
    with pytest.raises(FileDamagedError, match=message):
        replay(tmp_path / "run.mcap", cast("Any", None), tmp_path / "within")
    assert not (tmp_path / "evil").exists()


def test_a_run_in_raw_mode_walks_like_one_in_pd_mode(
    loaded: Loaded, lockstep: SimpleNamespace, tmp_path: Path
) -> None:
    """Estimator and PD law run in the runner; the twin takes torques."""
    path, readings = tmp_path / "raw.mcap", SensorReadings()
    log = RunLog(path, CASSIE_OUT, loaded.files, run_metadata("straight", readings, QUICK))
    supervisor = Supervisor(loaded.controller, QUICK)
    source = Scheduled(Schedule.parse("0.5"), duration=0.3)
    run = Run(supervisor, readings, source, log=log, say=lambda _: None)
    with connected(serve_lockstep, TwinRobot(raw=True), raw=True) as endpoint:
        run_lockstep(run, endpoint)
    run.close()
    names = [f"position_{motor}" for motor in CASSIE.motor_names]
    pd, raw = (read(file)["/tick"] for file in (lockstep.path, path))
    for name in names:
        # torques reach the twin in single precision; later footsteps amplify the difference
        np.testing.assert_allclose(raw[name][:4], pd[name][:4], atol=2e-4)
        np.testing.assert_allclose(raw[name][:10], pd[name][:10], atol=0.1)
    result = replay(path, lambda _: loaded.controller, tmp_path)
    assert (result.different, result.walked) == (0, 13)


def test_a_policy_with_a_planner_walks_over_stones(loaded: Loaded, tmp_path: Path) -> None:
    """The twin sends where they are; plans land on them, and logs replay."""
    path, readings, course = tmp_path / "stones.mcap", SensorReadings(), stairs(0.0)
    controller = Controller("directions", planner=Planner())
    warm_up(controller)
    twin = TwinRobot(partial(mujoco_engine, course=course), raw=True)
    log = RunLog(path, CASSIE_OUT, loaded.files, run_metadata("directions", readings, QUICK))
    seen: list[np.ndarray] = []
    with connected(serve_lockstep, twin, raw=True) as endpoint, Datagrams(0) as source:
        twin.guide = Guide(course, source.port, speed=0.4)
        run = Run(Supervisor(controller, QUICK), readings, source, log=log, say=lambda _: None)
        after = run.finish_tick

        def finish_tick(now: int, *timing: float) -> None:
            after(now, *timing)
            state = run.supervisor._state
            if state is not None:
                seen.append(state.tensordict["plan", "on_stones"][0].numpy())
            run.interrupted = "enough" if now > 2e9 else ""

        run.finish_tick = finish_tick
        run_lockstep(run, endpoint)
    run.close()
    twin.guide.close()
    # it stands at first
    assert (np.array(seen)[20:] > 0).mean() > 0.9
    assert twin.truth()["qpos"][0, 0] > 0.2
    result = replay(path, lambda _: controller, tmp_path)
    assert (result.different, result.walked) == (0, len(seen))


def serve_states(got: list[np.ndarray], until: float, server: Endpoint, stop: Any) -> None:
    """Send the state of a standing robot every 2 ms, for some time; collect the commands."""
    state, heard = estimate_to_state_out(standing_estimate()), 0.0
    while not stop():
        if server.wait(0.002) and (command := server.receive()) is not None:
            heard = heard or time.monotonic()
            got.append(command)
        if heard and time.monotonic() - heard < until:
            server.send(state)


def test_lost_packets_end_a_run_in_real_time_with_damping(loaded: Loaded) -> None:
    run, _ = make_run(loaded)
    got: list[np.ndarray] = []
    with connected(serve_states, got, 0.2) as endpoint:
        run_real_time(run, endpoint)
    assert run.supervisor.reason.startswith("no packet for 0.1")
    assert not pd_in_to_command(got[0]).damping.any()
    stiff = [bool(pd_in_to_command(command).stiffness.any()) for command in got]
    assert stiff.index(True) < len(stiff) - 1 - stiff[::-1].index(True)
    assert not stiff[-1]
    np.testing.assert_allclose(pd_in_to_command(got[-1]).damping, CASSIE.damping, rtol=1e-6)
    # repeated between policy steps
    assert len(got) > 2 * len(run.tally.work)


def test_an_interrupt_damps_a_run_in_real_time(loaded: Loaded) -> None:
    run, _ = make_run(loaded)
    with connected(serve_states, [], 1e6) as endpoint:
        timer = threading.Timer(0.15, setattr, (run, "interrupted", "operator: SIGTERM"))
        timer.start()
        run_real_time(run, endpoint)
    assert (run.supervisor.stage, run.supervisor.reason) == (Stage.DAMPING, "operator: SIGTERM")


def test_a_run_that_ends_at_once_leaves_damping_commands(
    loaded: Loaded, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = make_run(loaded)
    got: list[np.ndarray] = []
    monkeypatch.setattr(run, "finish_tick", Mock(side_effect=[None, None, KeyboardInterrupt]))
    with connected(serve_states, got, 1e6) as endpoint:
        with pytest.raises(KeyboardInterrupt):
            run_real_time(run, endpoint)
        time.sleep(0.05)
    last = pd_in_to_command(got[-1])
    assert not last.stiffness.any()
    assert last.damping.all()


def test_a_source_of_commands_that_fails_damps(loaded: Loaded) -> None:
    run, _ = make_run(loaded)
    run.source = Mock(request=Mock(side_effect=OSError("terminal is gone")))
    run.take(0, [Arrival(0, estimate_to_state_out(standing_estimate()))])
    run.tick(0)
    assert run.supervisor.reason == "no commands: OSError: terminal is gone"


def test_a_silent_robot_is_reported_with_what_to_check(loaded: Loaded) -> None:
    run, _ = make_run(loaded)
    silent = pytest.raises(NetworkError, match=r"no answer from 127.0.0.1:\d+ within 0.05 s")
    with robot_socket() as server, socket_to(server.local) as endpoint, silent:
        run_real_time(run, endpoint, patience=0.05)


@pytest.mark.parametrize("drive", [run_lockstep, run_real_time])
def test_a_robot_without_an_estimate_is_given_up(loaded: Loaded, drive: Any) -> None:
    def serve(server: Endpoint, stop: Any) -> None:
        while not stop():
            if server.wait(0.01) and server.receive() is not None:
                server.send(STATE_OUT.zeros())

    run, _ = make_run(loaded)
    wanted = r"127.0.0.1:\d+ answers, but no walk could begin within 0.05 s: waits, because esti"
    with connected(serve) as endpoint, pytest.raises(NetworkError, match=wanted):
        drive(run, endpoint, patience=0.05)


def test_the_tally_counts_late_and_skipped_steps() -> None:
    tally = Tally([0.0, LATE / 2, 2 * LATE], [0.001] * 3, [0.002] * 3, skipped=1)
    assert "3 policy steps, 1 skipped, 2 late by more than 2 ms (50.00 %)" in tally.lines()[0]


def test_a_priority_is_asked_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Mock()
    monkeypatch.setattr("os.sched_setscheduler", asked, raising=False)
    take_priority(0)
    assert not asked.called
    take_priority(20)
    (process, _, parameter), _ = asked.call_args
    assert (process, parameter.sched_priority) == (0, 20)
    asked.side_effect = PermissionError("Operation not permitted")
    with pytest.raises(ConfigurationError, match="real-time priority 20: Operation not permitted"):
        take_priority(20)


def test_policies_and_libraries_that_do_not_fit_are_named() -> None:
    with pytest.raises(ConfigurationError, match="follows other gaits"):
        load("straight", "single_reference")
    nine: Any = SimpleNamespace(
        plans=False, start=lambda *_, **__: SimpleNamespace(motor_target=np.zeros((1, 9)))
    )
    nine.step = lambda state, *_, **__: (state, state.motor_target)
    with pytest.raises(ConfigurationError, match="not ten finite angles"):
        warm_up(nine)
