import signal
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from aslip.base.processes import signals_raised
from aslip.errors import GaitOptimizationError, SolverError, SpeedOutOfRangeError
from aslip.rom import Mode, SlipParameters, optimize, optimize_gait, optimize_gaits

from .test_gait import ARRAYS


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (2.5, r"between 0 and 2\.4"),
        (np.nan, r"between 0 and 2\.4"),
        ([-1.3, 0.0, 0.0], r"forward speed must be between -1\.2 and 2\.4 m/s, got -1\.3"),
        ([0.0, 0.7, 0.0], r"sideways speed must be between -0\.6 and 0\.6 m/s, got 0\.7"),
        ([0.0, 0.0, -2.0], r"yaw rate must be between -1\.5 and 1\.5 rad/s, got -2"),
        ([0.0, np.nan, 0.0], "sideways speed .* got nan"),
    ],
)
def test_impossible_command_is_refused_with_the_range(command, message):
    with pytest.raises(SpeedOutOfRangeError, match=message):
        optimize_gait(command)


def test_bad_speed_in_a_range_is_refused_before_any_work():
    seen = []
    with pytest.raises(SpeedOutOfRangeError, match="9"):
        optimize_gaits([0.0, 9.0], progress=lambda *step: seen.append(step))
    assert not seen


def test_failed_optimisation_names_speed_status_and_worst_constraint(capfd):
    """Neither a solve that fails nor one that succeeds prints anything."""
    optimize_gait(0.7)
    # legs at most as long as the body is high, over feet 0.1 m to the side
    impossible = SlipParameters(max_leg_length=0.8)
    with pytest.raises(GaitOptimizationError, match=r"at 1 m/s: IPOPT .* worst constraint: \w+"):
        optimize_gait(1.0, parameters=impossible)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_solve_raises_the_interrupt(monkeypatch, kind):
    """CasADi turns what a signal handler raises into a RuntimeError of its own."""

    def interrupt(number, frame):
        raise kind

    optimize_gait(1.0)  # the problem is built
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with pytest.raises(kind):
            signal.setitimer(signal.ITIMER_REAL, 0.03)
            optimize_gait(1.0)
        assert signal.getsignal(signal.SIGALRM) is interrupt
        with signals_raised():
            signal.signal(signal.SIGALRM, signal.SIG_IGN)
        assert signal.signal(signal.SIGALRM, interrupt) is signal.SIG_IGN
        with pytest.raises(kind), signals_raised():
            try:
                signal.raise_signal(signal.SIGALRM)
            except BaseException as error:
                raise RuntimeError("of a library") from error
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("status", ["Insufficient_Memory", "NonIpopt_Exception_Thrown", None])
def test_a_status_that_says_nothing_about_the_problem_is_no_missing_gait(status):
    """None: the error came before the solver's end, and the status is of an earlier solve."""

    def stats():
        if status is None:
            raise RuntimeError("not solved")
        return {"return_status": status}

    problem: Any = SimpleNamespace(opti=SimpleNamespace(stats=stats), title=lambda _: "the gait")
    error = optimize._failure(problem, np.zeros(1), RuntimeError("in CasADi:\nstd::bad_alloc"))
    assert isinstance(error, SolverError)
    assert f"stopped with {status or 'std::bad_alloc'}" in str(error)


@pytest.mark.parametrize("speed", [0.4, 1.9])
def test_same_arguments_give_the_same_bits(speed):
    first, _, second = optimize_gait(speed), optimize_gait(1.2), optimize_gait(speed)
    for name in ARRAYS:
        np.testing.assert_array_equal(attrgetter(name)(first), attrgetter(name)(second))


@pytest.mark.parametrize("index", [0, 2, 4])
def test_gait_does_not_depend_on_the_initial_guess(gaits, index):
    """Continuation from the slower gait and a rough guess reach the same optimum."""
    alone = optimize_gait(gaits[index].speed)
    np.testing.assert_allclose(alone.body.position, gaits[index].body.position, atol=1e-5)
    assert alone.cost == pytest.approx(gaits[index].cost, rel=1e-7)


def test_mean_objective_prefers_longer_strides_than_the_integral(gait):
    integral = optimize_gait(1.0, objective="integral")
    assert integral.cost < gait.cost
    assert integral.cost / integral.stride > gait.cost / gait.stride
    assert integral.stride < gait.stride


def test_least_stance_force_keeps_the_standing_leg_loaded(gait):
    """A bound of 15 % body weight costs 3 % more effort and lowers the largest force by 6 %."""
    loaded = optimize_gait(1.0, parameters=SlipParameters(min_stance_force=0.15))
    standing = loaded.leg_force[loaded.mode == Mode.LEFT, 0]
    assert standing.min() == pytest.approx(0.15 * loaded.parameters.weight, abs=1e-6)
    assert gait.leg_force[gait.mode == Mode.LEFT, 0].min() == pytest.approx(0.0, abs=1e-6)
    more_effort = loaded.certificate.cost / gait.certificate.cost - 1.0
    assert more_effort == pytest.approx(0.033, abs=2e-3)
    assert loaded.leg_force.max() / gait.leg_force.max() == pytest.approx(0.942, abs=2e-3)
