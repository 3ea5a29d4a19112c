"""Arithmetic of headers, and counts of what arrives."""

import numpy as np
import pytest

from aslip.network.wire import PD_IN, STATE_OUT, Header, Link
from aslip.network.wire.link import wrapped


@pytest.fixture
def robot() -> Link:
    return Link(STATE_OUT, PD_IN, refuse_not_finite=True)


@pytest.fixture
def client() -> Link:
    return Link(PD_IN, STATE_OUT, refuse_not_finite=False)


def _command(number: int, target: float = 0.0, received: int = 0) -> bytes:
    """Datagram of a client."""
    record = PD_IN.zeros()
    record["left_leg"]["motor_pd"]["p_target"][:] = target
    return Header(number, received).to_bytes() + PD_IN.pack(record)


def _target(record: np.ndarray | None) -> float:
    assert record is not None
    return float(record["left_leg"]["motor_pd"]["p_target"][0])


def test_headers_are_two_signed_bytes() -> None:
    assert Header(-1, 5).to_bytes() == b"\xff\x05"
    assert Header.from_bytes(b"\x80\x7f") == (-128, 127)


def test_sequence_numbers_wrap_to_signed_bytes() -> None:
    assert [wrapped(number) for number in (127, 128, -129, 256)] == [127, -128, 127, 0]


def test_first_datagrams_have_number_one(robot: Link, client: Link) -> None:
    """The robot's first answer has number 1 and returns the client's."""
    first = client.datagram(PD_IN.zeros())
    assert first[:2] == b"\x01\x00"
    robot.open(first)
    answer = robot.datagram(STATE_OUT.zeros())
    assert answer[:2] == b"\x01\x01"


def test_lockstep_keeps_the_step_at_one_over_the_wrap(robot: Link, client: Link) -> None:
    for i in range(300):
        record = PD_IN.zeros()
        record["telemetry"][0] = i
        assert robot.open(client.datagram(record)) is not None
        answer = STATE_OUT.zeros()
        answer["terrain"]["height"] = i
        assert client.open(robot.datagram(answer)) is not None
    assert (robot.step, client.step) == (1, 1)
    assert robot.counters == client.counters
    assert robot.counters.accepted == 300
    assert robot.counters.lost == robot.counters.late == robot.counters.restarts == 0


@pytest.mark.parametrize("start", [10, 125, -3])
def test_lost_datagrams_are_counted(robot: Link, start: int) -> None:
    robot.open(_command(start))
    assert _target(robot.open(_command(start + 4, 0.4))) == np.float32(0.4)
    assert (robot.step, robot.counters.lost) == (4, 3)


@pytest.mark.parametrize("start", [10, 127])
def test_late_datagrams_are_dropped(robot: Link, start: int) -> None:
    robot.open(_command(start))
    robot.open(_command(start + 2))
    assert robot.open(_command(start + 1)) is None
    assert robot.open(_command(start + 3)) is not None
    assert robot.counters.late == 1


def test_a_repeated_number_with_other_content_is_new(robot: Link) -> None:
    """The public simulator counts what it answers, not what it sends."""
    robot.open(_command(1, 0.1))
    assert _target(robot.open(_command(1, 0.2))) == np.float32(0.2)
    assert (robot.step, robot.counters.repeated) == (0, 0)


def test_a_robot_drops_commands_that_are_not_finite(robot: Link) -> None:
    robot.open(_command(1))
    assert robot.open(_command(2, np.nan)) is None
    assert robot.open(_command(3)) is not None
    assert (robot.counters.not_finite, robot.counters.lost) == (1, 1)


def test_a_client_reads_and_counts_states_that_are_not_finite(robot: Link, client: Link) -> None:
    state = STATE_OUT.zeros()
    state["pelvis"]["position"][2] = np.nan
    record = client.open(robot.datagram(state))
    assert record is not None
    assert np.isnan(record["pelvis"]["position"][2])
    assert client.counters.not_finite == client.counters.accepted == 1


def test_a_peer_that_restarts_after_a_silence_is_accepted_again(robot: Link) -> None:
    robot.open(_command(57))
    assert robot.open(_command(1, 0.1)) is None
    assert robot.open(_command(2, 0.1), silent=True) is not None
    assert (robot.counters.late, robot.counters.restarts) == (1, 1)
    assert robot.open(_command(3)) is not None
    assert robot.counters.lost == 0


def test_a_silence_alone_is_not_a_restart(robot: Link) -> None:
    """A client in lockstep may think for long, and then count on or repeat itself."""
    robot.open(_command(57))
    assert robot.open(_command(57), silent=True) is None
    assert robot.open(_command(58), silent=True) is not None
    assert (robot.counters.repeated, robot.counters.restarts, robot.step) == (1, 0, 1)


def test_late_datagrams_in_order_are_not_a_restart(robot: Link) -> None:
    """A network that reorders delivers many late datagrams in a row."""
    robot.open(_command(40))
    assert all(robot.open(_command(number)) is None for number in range(20, 40))
    assert (robot.counters.late, robot.counters.restarts) == (20, 0)


def test_random_datagrams_are_counted_once_each(robot: Link) -> None:
    rng = np.random.default_rng(4)
    sizes = rng.choice([0, 1, 2, 60, 477, 478, 479, 699], 3000)
    for size in sizes:
        robot.open(rng.bytes(size))
    c = robot.counters
    assert c.wrong_size == (sizes != 478).sum()
    assert c.wrong_size + c.accepted + c.not_finite + c.late == len(sizes)
