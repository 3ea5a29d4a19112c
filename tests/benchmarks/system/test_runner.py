"""Walks with lost and late datagrams, in simulated time."""

import numpy as np
import pytest

from aslip.network.runner.load import Loaded, load
from aslip.network.wire import PD_IN, STATE_OUT, Link
from benchmarks.system.runner import Config, LossyPath, lossy_walk, tick_costs


@pytest.fixture(scope="module")
def loaded() -> Loaded:
    return load("straight")


def path(loss: float, jitter: float) -> tuple[LossyPath, Link]:
    receiver = Link(STATE_OUT, PD_IN, refuse_not_finite=True)
    sender = Link(PD_IN, STATE_OUT, refuse_not_finite=False)
    return LossyPath(sender, receiver, loss, jitter, np.random.default_rng(0)), receiver


def test_without_losses_every_packet_arrives_at_once() -> None:
    lossless, _ = path(0.0, 0.0)
    for tick in range(5):
        lossless.send(tick, PD_IN.zeros())
        assert len(lossless.arrivals(tick)) == 1


def test_losses_and_delays_are_those_asked_for() -> None:
    lossy, receiver = path(0.2, 20.0)
    accepted = 0
    for tick in range(2000):
        lossy.send(tick, PD_IN.zeros())
        accepted += len(lossy.arrivals(tick))
    c = receiver.counters
    assert accepted == c.accepted
    assert 0.77 < (c.accepted + c.late) / 2000 < 0.83
    # of two packets sent after one another, the second often arrives first
    assert 300 < c.late < 1500


def test_a_walk_survives_a_fifth_lost_and_ends_without_a_network(loaded: Loaded) -> None:
    walked, reason, counts = lossy_walk(loaded, 0.5, Config(duration=0.45), seed=0)
    assert (round(walked, 2), reason) == (0.42, "")
    assert all(count > 0 for count in counts)
    walked, reason, _ = lossy_walk(loaded, 0.5, Config(duration=0.9, loss=0.995), seed=0)
    assert "no packet for" in reason
    assert walked < 0.9


def test_the_cost_of_a_tick_is_a_part_of_its_time() -> None:
    lines = tick_costs(Config(part="tick", duration=0.01)).splitlines()
    assert [line.split(":")[0] for line in lines] == ["tick in PD mode", "tick in raw mode"]
    assert all(0.01 < float(line.split()[-4]) < 50 for line in lines)
