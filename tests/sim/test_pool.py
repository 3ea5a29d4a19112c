"""Simulations in parts equal simulations in one, bit for bit."""

import multiprocessing
import signal
import threading
import time
from multiprocessing.connection import Connection

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.sim import SimulationPool, Simulations

# more than one part of the largest size, and a remainder
NUM = 70


def _assert_equal(pool: SimulationPool, simulations: Simulations) -> None:
    ours, theirs = vars(pool.snapshot()), vars(simulations.snapshot())
    for name, value in ours.items():
        np.testing.assert_array_equal(value, theirs[name], err_msg=name)
    for name, window in pool.packets().items():
        np.testing.assert_array_equal(window, simulations.sensors.packets()[name], err_msg=name)


@pytest.mark.parametrize("threads", [1, 3])
def test_parts_equal_a_single_batch(threads: int) -> None:
    rng = np.random.default_rng(0)
    pool, whole = SimulationPool(NUM, num_threads=threads), Simulations(NUM, num_threads=1)
    assert len(pool.parts) >= 2
    _assert_equal(pool, whole)
    for step in range(4):
        target = whole.qpos[:, whole.indices.motor_qpos] + rng.normal(0, 0.3, (NUM, 10))
        np.testing.assert_array_equal(pool.advance(target), whole.advance(target))
        if step == 1:
            ids = np.array([0, 33, 34, 35, 64, NUM - 1])
            qpos = whole.qpos[ids] + 0.0
            qpos[:, 0] += 1.0
            for simulations in (pool, whole):
                simulations.reset(ids, qpos)
        _assert_equal(pool, whole)


def test_each_part_gets_its_own_pushes() -> None:
    pool, whole = SimulationPool(5, num_threads=2), Simulations(5, num_threads=1)
    assert len(pool.parts) == 2
    push = np.random.default_rng(0).normal(0, 50, (5, 3))
    target = whole.qpos[:, whole.indices.motor_qpos].copy()
    for simulations in (pool, whole):
        simulations.advance(target, push)
    np.testing.assert_array_equal(pool.states(), whole.states())


def _interrupt() -> None:
    """Send Ctrl-C to the main thread."""
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)  # pyright: ignore


def _fail() -> None:
    raise RuntimeError("a part failed")


@pytest.mark.parametrize(
    ("event", "error"), [(_interrupt, KeyboardInterrupt), (_fail, RuntimeError)]
)
def test_all_threads_stop_after_an_error_or_interrupt(
    monkeypatch: pytest.MonkeyPatch, event, error: type[BaseException]
) -> None:
    pool = SimulationPool(4, num_threads=2)
    target = pool.snapshot().qpos[:, pool.indices.motor_qpos]
    both_began, advance, events = threading.Barrier(2), Simulations.advance, [lambda: None, event]

    def slow(part: Simulations, *args) -> np.ndarray:
        both_began.wait()
        if part is pool.parts[0]:
            events.pop(0)()
        else:
            time.sleep(0.1)
        return advance(part, *args)

    monkeypatch.setattr(Simulations, "advance", slow)
    pool.advance(target)  # starts both threads
    with pytest.raises(error):
        pool.advance(target)
    assert pool.parts[1].batch.bind("time").tolist() == pytest.approx(
        [2 * CASSIE.policy_period] * 2
    )


def _step_in_child(pool: SimulationPool, target: np.ndarray, answer: Connection) -> None:
    for use in (lambda: pool.advance(target), lambda: pool.reset(np.arange(pool.num))):
        try:
            use()
            answer.send("stepped")
        except ConfigurationError as error:
            answer.send(str(error))


@pytest.mark.parametrize("used", [False, True])
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_forked_processes_are_refused(used: bool) -> None:
    """Without its threads a forked pool would wait forever."""
    pool = SimulationPool(2, num_threads=2)
    target = pool.snapshot().qpos[:, pool.indices.motor_qpos]
    if used:
        pool.advance(target)
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("fork")
    child = context.Process(target=_step_in_child, args=(pool, target, theirs), daemon=True)
    child.start()
    try:
        for _ in range(2):
            assert ours.poll(60), "the child hangs"
            answer = ours.recv()
            assert ("its fork" in answer) if used else (answer == "stepped")
    finally:
        child.kill()
        child.join()
    pool.advance(target)
