"""A controller at the other end of a socket walks the twin as it walks the simulation."""

import time
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
import pytest
from tensordict import TensorDictBase

from aslip.control import Controller
from aslip.envs import BatchEnv
from aslip.library import GaitLibrary
from aslip.network.twin import TwinRobot, serve_lockstep
from aslip.network.wire import (
    PD_IN,
    STATE_OUT,
    USER_IN,
    Endpoint,
    Link,
    cassie_out_to_sensors,
    command_to_pd_in,
    state_out_to_estimate,
    torque_to_user_in,
)
from aslip.robot import CASSIE
from aslip.sim import PD, Simulations, Torque
from tests.network.twin.sockets import ANY_PORT, robot_socket, serving, socket_to

STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]
# the robot whose gains are those that reach the twin in single precision
ROUNDED = replace(CASSIE, damping=CASSIE.damping.astype(np.float32).astype(np.float64))


_ENCODERS = ("position", "velocity")


def answered(
    twin: TwinRobot, server: Endpoint, client: Endpoint, command: np.ndarray
) -> np.ndarray:
    """Answer to a command, of both sides in one thread."""
    ticks = twin.ticks
    client.send(command)
    serve_lockstep(twin, server, lambda: twin.ticks > ticks)
    assert client.wait(1.0)
    answer = client.receive()
    assert answer is not None
    return answer


@pytest.fixture(scope="module")
def controller() -> Controller:
    return Controller("straight", GaitLibrary.load())


def test_two_seconds_over_loopback_equal_the_simulation_in_one_process(
    controller: Controller,
) -> None:
    """The client sees states only; the simulation beside it sees packets."""
    twin, env = TwinRobot(), BatchEnv(1, num_threads=1, robot=ROUNDED)
    now = env.reset()
    with robot_socket() as server, socket_to(server.local) as client:
        state = answered(twin, server, client, PD_IN.zeros())
        env.set_states(twin.states())
        over_wire = controller.start(state_out_to_estimate(state), 0.5, heading=0.0)
        in_process = controller.start(twin.packet(), 0.5, heading=0.0)
        for _ in range(67):
            target = over_wire.motor_target
            np.testing.assert_array_equal(target, in_process.motor_target)
            for _ in range(CASSIE.substeps):
                state = answered(twin, server, client, command_to_pd_in(target[0].numpy()))
            now = env.step(now.set("motor_target", in_process.motor_target))["next"]
            np.testing.assert_array_equal(twin.states(), env.states())
            over_wire, _ = controller.step(over_wire, state_out_to_estimate(state))
            in_process, _ = controller.step(in_process, cast("TensorDictBase", now["sensors"]))
        counters = (server.link.counters, client.link.counters)
    assert twin.ticks == 1 + 67 * CASSIE.substeps == counters[0].accepted == counters[1].accepted
    assert all(c.lost == c.late == c.wrong_size == c.not_finite == 0 for c in counters)
    assert now["truth", "pelvis_position"][0, 0] > 0.5


class RoundedPD(PD):
    """PD loop of a client: readings and torques travel in single precision."""

    def torque(
        self,
        command: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        torque = self.joint_torque(command, _single(position), _single(velocity))
        return Torque(1).torque(_single(torque), position, velocity, out=out)


def _single(values: np.ndarray) -> np.ndarray:
    """Numbers rounded to single precision."""
    return values.astype(np.float32).astype(np.float64)


def test_a_client_that_closes_the_loop_equals_the_simulation_in_one_process() -> None:
    """In raw mode the torque of a tick follows from the sensors of the tick before."""
    twin, beside = TwinRobot(raw=True), Simulations(1, num_threads=1, drive=RoundedPD)
    pd = PD(1)
    with robot_socket(raw=True) as server, socket_to(server.local, raw=True) as client:
        record = answered(twin, server, client, USER_IN.zeros())
        beside.set_states(twin.states())
        for step in range(3):
            target = STANDING[None] + 0.05 * step
            for _ in range(CASSIE.substeps):
                sensors = cassie_out_to_sensors(record)
                seen = (sensors[f"motor_{kind}"][None].astype(float) for kind in _ENCODERS)
                torque = pd.joint_torque(target, *seen)[0]
                record = answered(twin, server, client, torque_to_user_in(torque))
            beside.advance(target)
            np.testing.assert_array_equal(twin.states(), beside.states())
    final = {name: window[0, -1] for name, window in beside.sensors.packets().items()}
    sensors = cassie_out_to_sensors(record)
    # the packets of a period have mean forces
    for name in sensors.keys() - {"accelerometer"}:
        np.testing.assert_array_equal(sensors[name], final[name].astype(np.float32))
    legs = [record[f"{side}_leg"]["drives"]["torque"] for side in ("left", "right")]
    np.testing.assert_array_equal(np.concatenate(legs), np.float32(beside.motor_torque[0]))


def test_a_repeated_command_is_answered_without_a_tick() -> None:
    twin = TwinRobot()
    with serving(serve_lockstep, twin) as server, socket_to(server.local) as client:
        state = client.request(command_to_pd_in(STANDING))
        client.resend()
        assert client.wait(1.0)
        assert client.receive() is None
        assert (twin.ticks, client.link.counters.repeated) == (1, 1)
        again = client.request(command_to_pd_in(STANDING))
        assert twin.ticks == 2
        assert client.link.step == 1
        assert state.shape == again.shape == ()


def test_clients_one_after_another_begin_with_the_robot_on_its_feet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also one at the address of the first; one that only pauses goes on."""
    for name in ("twin.lockstep.SILENCE", "wire.endpoint.SILENCE", "twin.lockstep._GONE"):
        monkeypatch.setattr(f"aslip.network.{name}", 0.02)
    monkeypatch.setattr("aslip.network.twin.lockstep._PATIENCE", 0.005)
    said, twin, starts, port = list[str](), TwinRobot(), [], ANY_PORT
    with serving(partial(serve_lockstep, say=said.append), twin) as server:
        for _ in range(2):
            link = Link(PD_IN, STATE_OUT, refuse_not_finite=False)
            with Endpoint(link, port, server.local) as client:
                port = client.local
                client.request(PD_IN.zeros())
                starts.append(twin.states())
                for _ in range(20):
                    client.request(command_to_pd_in(STANDING))
                time.sleep(0.05)
                client.request(PD_IN.zeros())
                assert twin.ticks == 22
                time.sleep(0.05)
    np.testing.assert_array_equal(*starts)
    assert said == [f"client {port}", f"no command from {port} for 0.02 s: waiting"]


def test_commands_that_are_not_finite_move_nothing() -> None:
    twin = TwinRobot()
    with serving(serve_lockstep, twin) as server, socket_to(server.local) as client:
        for _ in range(2):
            client.send(command_to_pd_in(np.full(10, np.nan)))
        client.resend()
        client.request(command_to_pd_in(STANDING))
        assert (twin.ticks, twin.divergences) == (1, 0)
        assert server.link.counters.not_finite == 3
