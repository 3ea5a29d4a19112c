"""Optimal walking gaits of the actuated SLIP, one mean speed or a range of them.

Guarantees: equal arguments give bit-equal gaits on one machine; every gait returned carries a
certificate without failures; nothing is printed. Trap: IPOPT and the problem it works on are kept
between calls, so call from one thread at a time.
"""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from aslip.errors import GaitOptimizationError, SpeedOutOfRangeError
from aslip.rom.certify import certify, slacks
from aslip.rom.gait import Gait
from aslip.rom.problem import HalfStride, WalkingProblem, walking_problem
from aslip.rom.slip import Objective, SlipParameters
from aslip.rom.unfold import fold, unfold


def optimize_gait(
    speed: float,
    *,
    parameters: SlipParameters | None = None,
    guess: Gait | None = None,
    objective: Objective = "mean",
) -> Gait:
    r"""Optimise the most economical periodic gait at a mean speed.

    .. math:: \min \frac1T \int_0^T (u_l^2 + u_r^2)\,dt

    Paper says the integral is minimised; the gaits released by its authors minimise the mean over
    the stride, which lengthens double stance by 8 %. We minimise the mean, because the released
    gaits trained the published policies, and because at a given speed the mean is the cost of
    transport. Strides and body heights then agree with the released gaits to 0.5 ms and 0.5 mm.
    `objective="integral"` follows the paper's formula.

    Args:
        speed: mean forward speed [m/s], from 0 to `parameters.max_speed`.
        parameters: model and bounds; Table I by default.
        guess: gait to start from, for instance at a nearby speed; a rough guess by default.
        objective: "mean" or "integral" of u_l^2 + u_r^2 over the stride.

    Returns:
        The gait, with a certificate without failures.

    Raises:
        SpeedOutOfRangeError: the speed is not finite or out of range.
        GaitOptimizationError: the solver found no gait, or a check of its certificate failed.
    """
    p = parameters or SlipParameters()
    _check_speed(speed, p)
    problem = walking_problem(p, objective)
    start = problem.rough_guess(speed) if guess is None else fold(guess)
    return _solve(problem, float(speed), start)


def optimize_gaits(
    speeds: Sequence[float],
    *,
    parameters: SlipParameters | None = None,
    objective: Objective = "mean",
    progress: Callable[[int, int, Gait], None] | None = None,
) -> list[Gait]:
    """Optimise gaits at several speeds, each from the previous one as initial guess.

    Args:
        speeds: mean forward speeds [m/s], best in ascending or descending order.
        parameters: model and bounds; Table I by default.
        objective: as in `optimize_gait`.
        progress: called after each gait with its index, the number of gaits and the gait.

    Returns:
        One gait per speed, in the order given.

    Raises:
        SpeedOutOfRangeError: a speed is not finite or out of range; raised before any solve.
        GaitOptimizationError: as in `optimize_gait`.
    """
    for speed in speeds:
        _check_speed(speed, parameters or SlipParameters())
    gaits: list[Gait] = []
    for index, speed in enumerate(speeds):
        guess = gaits[-1] if gaits else None
        gait = optimize_gait(speed, parameters=parameters, guess=guess, objective=objective)
        gaits.append(gait)
        if progress is not None:
            progress(index, len(speeds), gait)
    return gaits


def _check_speed(speed: float, p: SlipParameters) -> None:
    if not (math.isfinite(speed) and 0.0 <= speed <= p.max_speed):
        raise SpeedOutOfRangeError(
            f"walking speed must be between 0 and {p.max_speed:g} m/s, got {speed}"
        )


def _solve(problem: WalkingProblem, speed: float, start: HalfStride) -> Gait:
    opti = problem.opti
    opti.set_value(problem.speed, speed)
    # multipliers start from zero, so that the gait depends on the arguments alone
    opti.set_initial(opti.lam_g, 0.0)
    problem.start_from(start)
    began = time.perf_counter()
    try:
        opti.solve()
    except RuntimeError:
        raise GaitOptimizationError(_failure(problem, speed)) from None
    seconds = time.perf_counter() - began
    half = problem.solution()
    certificate = certify(problem, half, speed, seconds)
    if not certificate.ok:
        raise GaitOptimizationError(
            f"the gait at {speed:g} m/s is not certified: {'; '.join(certificate.failures())}"
        )
    return unfold(half, speed, certificate, problem.parameters)


def _failure(problem: WalkingProblem, speed: float) -> str:
    """Error message from the solver's last iterate."""
    opti = problem.opti
    x, lam = opti.debug.value(opti.x), np.zeros(opti.ng)
    _, g, lower, upper = (v.full().ravel() for v in problem.optimality(x, lam, speed))
    nearest = slacks(problem, g, lower, upper)
    worst = min(nearest, key=lambda name: nearest[name])
    return (
        f"no gait found at {speed:g} m/s: IPOPT stopped with {opti.stats()['return_status']} after "
        f"{opti.stats()['iter_count']} iterations; worst constraint: {worst}, "
        f"violated by {max(-nearest[worst], 0.0):.2e}"
    )
