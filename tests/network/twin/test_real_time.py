"""Real time: the held command, silences, stops, clients one after the other, and late ticks."""

import signal
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.network.twin import RealTimeServer, TwinRobot
from aslip.network.wire import (
    CASSIE_OUT,
    LOOPBACK,
    SIMULATOR,
    STOP_CHANNEL,
    USER_IN,
    Address,
    Endpoint,
    command_to_pd_in,
    torque_to_user_in,
)
from aslip.network.wire.endpoint import SILENCE
from aslip.robot import CASSIE
from tests.helpers import started
from tests.network.twin.sockets import robot_socket, socket_to

STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]
PERIOD = CASSIE.physics_timestep


class Bench:
    """Twin in real time whose ticks a test takes itself, and one client."""

    def __init__(self, twin: TwinRobot, **settings: object) -> None:
        twin.reset()
        twin.radio[:], twin.radio[STOP_CHANNEL] = 0, 1
        self.twin, self.said, self.now = twin, list[str](), 0.0
        settings = {"clock": lambda: self.now, **settings}
        self.raw = twin.sends is CASSIE_OUT
        self.socket = robot_socket(self.raw)
        self.server = RealTimeServer(twin, self.socket, say=self.said.append, **settings)  # pyright: ignore[reportArgumentType]
        self.client = self.another()

    def another(self) -> Endpoint:
        return socket_to(self.socket.local, self.raw)

    def tick(self, number: int = 1, command: np.ndarray | None = None) -> np.ndarray:
        """Advance, with a command at the first tick; return the client's newest answer."""
        if command is not None:
            self.client.send(command)
        answers = []
        for _ in range(number):
            self.now += PERIOD
            self.server.tick()
            answers += self.client.receive_all()
        return answers[-1].record


@pytest.fixture(scope="module")
def twin() -> TwinRobot:
    return TwinRobot()


@pytest.fixture
def bench(twin: TwinRobot) -> Iterator[Bench]:
    made = Bench(twin)
    with made.socket, made.client:
        yield made


HOLD = command_to_pd_in(STANDING)
NOTHING = command_to_pd_in(np.zeros(10), 0.0, 0.0)


def test_the_robot_stands_still_until_a_command_has_gains(bench: Bench, twin: TwinRobot) -> None:
    before = twin.states()
    answer = bench.tick(30, NOTHING)
    np.testing.assert_array_equal(twin.states(), before)
    assert abs(answer["pelvis"]["position"][2] - 1.0) < 0.1
    bench.tick(3, HOLD)
    assert twin.ticks == 3


def test_every_tick_is_answered_and_holds_the_last_command(bench: Bench, twin: TwinRobot) -> None:
    bench.tick(40, HOLD)
    assert bench.client.link.counters.accepted == 40
    alone = TwinRobot()
    for _ in range(40):
        alone.tick(HOLD)
    np.testing.assert_array_equal(twin.states(), alone.states())


def test_a_silence_of_100_ms_drops_the_command(bench: Bench, twin: TwinRobot) -> None:
    bench.tick(200, HOLD)
    assert bench.server.load.silences == 0
    velocity = twin.packet()["motor_velocity"]
    bench.tick(1)
    assert bench.server.load.silences == 1
    assert f"no command from {bench.client.local} for 100 ms: damping" in bench.said
    # torques arrive six ticks later
    answer = bench.tick(6)
    expected = -CASSIE.damping * velocity
    np.testing.assert_allclose(answer["motor"]["torque"], expected, rtol=1e-4, atol=1e-6)


def test_a_silence_of_10_ms_drops_the_torque_in_raw_mode() -> None:
    bench = Bench(TwinRobot(raw=True))
    with bench.socket, bench.client:
        bench.tick(20, torque_to_user_in(np.full(10, 0.1)))
        assert bench.server.load.silences == 0
        answer = bench.tick(1)
        assert bench.server.load.silences == 1
        assert answer["is_calibrated"]


def test_ticks_that_are_caught_up_are_not_a_silence(bench: Bench) -> None:
    """The client had no time to answer."""
    bench.tick(1, HOLD)
    for _ in range(300):
        bench.server.tick()
    assert bench.server.load.silences == 0
    bench.tick(201)
    assert bench.server.load.silences == 1


def test_the_emergency_stop_takes_all_torque_away(bench: Bench, twin: TwinRobot) -> None:
    assert np.any(bench.tick(20, HOLD)["motor"]["torque"])
    twin.radio[[9, STOP_CHANNEL]] = 0.5, -1
    answer = bench.tick(7, HOLD)
    assert not answer["motor"]["torque"].any()
    np.testing.assert_array_equal(answer["radio"]["channel"][[8, 9]], [-1, 0.5])
    twin.radio[STOP_CHANNEL] = 1
    assert np.any(bench.tick(7, HOLD)["motor"]["torque"])


def test_a_client_after_another_one_finds_the_robot_on_its_feet(
    bench: Bench, twin: TwinRobot
) -> None:
    bench.tick(300, HOLD)
    time.sleep(SILENCE + 0.02)
    bench.now += 1.0
    with bench.another() as second:
        second.send(NOTHING)
        bench.server.tick()
        assert twin.standing
        assert second.receive() is not None
        assert bench.said[-1] == f"client {second.local}"


def test_a_client_that_was_silent_goes_on_with_the_robot_where_it_is(
    bench: Bench, twin: TwinRobot
) -> None:
    bench.tick(300, HOLD)
    bench.tick(1, HOLD)
    assert twin.ticks == 301
    assert not twin.idle


def test_pushes_act_for_their_duration(twin: TwinRobot) -> None:
    """100 N for 10 ms on 33 kg give the pelvis a speed that rest does not."""
    speeds = []
    for force in (0.0, 100.0):
        twin.reset()
        if force:
            twin.push([0.0, force, 0.0], 0.01)
        for _ in range(40):
            twin.tick(HOLD)
        speeds.append(twin.states()[0, 1 + 35 + 1])
    assert speeds[1] - speeds[0] > 0.01
    with pytest.raises(ConfigurationError, match="three finite forces"):
        twin.push([0.0, np.nan, 0.0], 0.1)
    with pytest.raises(ConfigurationError, match="positive duration"):
        twin.push([0.0, 1.0, 0.0], 0.0)


def test_ticks_keep_absolute_deadlines_and_late_ones_are_counted(twin: TwinRobot) -> None:
    """A clock that stands still but for sleeps, and jumps by 2 ms and by 0.3 s."""
    now, jumps = [0.0], {100: 2e-3, 150: 0.3}

    def sleep(duration: float) -> None:
        now[0] += duration

    bench = Bench(twin, clock=lambda: now[0], sleep=sleep)
    load = bench.server.load

    def stop() -> bool:
        now[0] += jumps.pop(load.ticks, 0.0)
        return load.ticks == 400

    with bench.socket, bench.client:
        bench.server.run(stop)
    # 2 ms are caught up; of 0.3 s, all but the first tick is left out
    assert load.late in (2, 3)
    assert load.skipped in (599, 600)
    assert load.latest == pytest.approx(2e-3, abs=PERIOD)
    assert now[0] == pytest.approx((400 + load.skipped) * PERIOD, abs=2 * PERIOD)
    assert "400 ticks" in str(load)


def test_the_program_runs_in_real_time() -> None:
    program = [sys.executable, "-m", "aslip.network.twin", "--real-time", "--raw", "--port", "0"]
    with started(program) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().split(f"{SIMULATOR.host}:")[1].split(";")[0])
        with socket_to(Address(LOOPBACK, port), raw=True) as client:
            client.request(USER_IN.zeros(), timeout=30.0)
        process.send_signal(signal.SIGTERM)
        said = process.stdout.read()
        assert " ticks, " in said and "divergences, datagrams" in said
    assert process.returncode == 128 + signal.SIGTERM
