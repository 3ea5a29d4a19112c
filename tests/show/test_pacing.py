"""Pacing of a loop on a simulated clock."""

import pytest

from aslip.show.pacing import MOST_BEHIND, Pacer

PERIOD = 0.03


class Clock:
    """Simulated clock, on which sleeping takes a little longer than asked for."""

    def __init__(self) -> None:
        self.time = 1e5
        self.slept: list[float] = []

    def work(self, seconds: float) -> None:
        self.time += seconds

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.slept.append(seconds)
        self.time += seconds + 0.0007

    def pacer(self) -> Pacer:
        return Pacer(PERIOD, clock=lambda: self.time, sleep=self.sleep)


def test_late_sleeps_do_not_add_up():
    clock = Clock()
    pacer, start = clock.pacer(), clock.time
    for i in range(1, 1001):
        clock.work(0.002 * (i % 9))
        pacer.wait()
        assert clock.time - start == pytest.approx(i * PERIOD, abs=0.001)
    assert pacer.factor == pytest.approx(1.0, abs=1e-3)


def test_short_stall_is_caught_up():
    clock = Clock()
    pacer, start = clock.pacer(), clock.time
    clock.work(0.1)
    for _ in range(10):
        pacer.wait()
        clock.work(0.005)
    assert clock.time - start == pytest.approx(10 * PERIOD + 0.005, abs=0.001)


def test_long_stall_is_caught_up_in_part():
    clock = Clock()
    pacer = clock.pacer()
    clock.work(10.0)
    turns = 0
    while not clock.slept:
        pacer.wait()
        turns += 1
    assert turns == int(MOST_BEHIND / PERIOD) + 2


def test_restart_drops_the_delay():
    clock = Clock()
    pacer = clock.pacer()
    clock.work(10.0)
    pacer.restart()
    assert pacer.factor == 1.0
    pacer.wait()
    assert clock.slept == [pytest.approx(PERIOD)]
