"""Optimal gaits of the actuated SLIP, at one command or several, and their stop and start.

Guarantees: equal arguments give bit-equal gaits on one machine; every gait returned carries a
certificate without failures; nothing is printed. Trap: IPOPT and the problem it works on are kept
between calls, so call from one thread at a time.
"""

import time
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from aslip.base.processes import signals_raised
from aslip.errors import GaitOptimizationError, ShapeError, SolverError, SpeedOutOfRangeError
from aslip.rom.certificate import Certificate
from aslip.rom.certify import certify, slacks
from aslip.rom.full_stride import WholeStride, gait_of_stride, stride_of_gait, stride_problem
from aslip.rom.gait import Gait
from aslip.rom.half_stride import HalfStride, fold, half_stride_problem, unfold
from aslip.rom.program import GaitProgram
from aslip.rom.slip import Objective, SlipParameters
from aslip.rom.standing import Transition
from aslip.rom.stop_start import (
    StopAndStart,
    ends_of_gait,
    stop_start_problem,
    transitions_from_modes,
)

ABOUT_THE_PROBLEM: Final = frozenset(
    {
        *("Infeasible_Problem_Detected", "Restoration_Failed", "Maximum_Iterations_Exceeded"),
        *("Diverging_Iterates", "Search_Direction_Becomes_Too_Small", "Invalid_Number_Detected"),
        *("Error_In_Step_Computation", "Not_Enough_Degrees_Of_Freedom", "Feasible_Point_Found"),
        "Solved_To_Acceptable_Level",
    }
)
"""Statuses of IPOPT that say that it finds no gait. After any other, such as
`NonIpopt_Exception_Thrown` or `Insufficient_Memory`, the next attempt may find one."""

_Solution = TypeVar("_Solution", HalfStride, WholeStride, StopAndStart)


@signals_raised()
def optimize_gait(
    command: ArrayLike,
    *,
    parameters: SlipParameters | None = None,
    guess: Gait | None = None,
    objective: Objective = "mean",
) -> Gait:
    r"""Optimise the most economical periodic gait at a speed, or at a command with three numbers.

    .. math:: \min \frac1T \int_0^T (u_l^2 + u_r^2)\,dt

    A speed gives the paper's gaits: straight ahead, one half of the stride the exact mirror image
    of the other. A forward speed, sideways speed and yaw rate give a gait in that direction, solved
    over the whole stride; straight ahead it is the paper's, with another origin along the path.

    Paper says the integral is minimised; the gaits released by its authors minimise the mean over
    the stride, which lengthens double stance by 8 %. We minimise the mean, because the released
    gaits trained the published policies, and because at a given speed the mean is the cost of
    transport. Strides and body heights then agree with the released gaits to 0.5 ms and 0.5 mm.
    `objective="integral"` follows the paper's formula.

    Args:
        command: mean forward speed [m/s], from 0 to `parameters.max_speed`; or three numbers:
            forward speed, sideways speed [m/s] and yaw rate [rad/s], within
            the largest values of `parameters`.
        parameters: model and bounds; Table I by default.
        guess: gait to start from, for instance at a nearby command; a rough guess by default.
        objective: "mean" or "integral" of u_l^2 + u_r^2 over the stride.

    Returns:
        The gait, with a certificate without failures.

    Raises:
        ShapeError: the command has neither one number nor three, or the guess another number of
            collocation points than the optimiser.
        SpeedOutOfRangeError: a number is not finite or out of range.
        GaitOptimizationError: the solver found no gait, or a check of its certificate failed.
        SolverError: the solver failed for another reason, such as a lack of memory. An exception
            of a signal handler, such as KeyboardInterrupt, is raised as it is.
    """
    p = parameters or SlipParameters()
    numbers = _checked(command, p)
    if len(numbers) == 1:
        problem = half_stride_problem(p, objective)
        start = problem.rough_guess(float(numbers[0])) if guess is None else fold(guess)
        return unfold(*_solve(problem, numbers, start), p)
    problem = stride_problem(p, objective)
    start = problem.rough_guess(numbers) if guess is None else stride_of_gait(guess, numbers)
    return gait_of_stride(*_solve(problem, numbers, start), p)


def optimize_gaits(
    commands: Sequence[ArrayLike],
    *,
    parameters: SlipParameters | None = None,
    objective: Objective = "mean",
    progress: Callable[[int, int, Gait], None] | None = None,
) -> list[Gait]:
    """Optimise gaits at several commands, each from the nearest one before it as initial guess.

    Args:
        commands: as in `optimize_gait`, best in an order in which neighbours follow each other.
        parameters: model and bounds; Table I by default.
        objective: as in `optimize_gait`.
        progress: called after each gait with its index, the number of gaits and the gait.

    Returns:
        One gait per command, in the order given.

    Raises:
        ShapeError: a command has neither one number nor three; raised before any solve.
        SpeedOutOfRangeError: a number is not finite or out of range; raised before any solve.
        GaitOptimizationError: as in `optimize_gait`.
        SolverError: as in `optimize_gait`.
    """
    checked = [_checked(command, parameters or SlipParameters()) for command in commands]
    gaits: list[Gait] = []
    for index, command in enumerate(checked):
        guess = _nearest(gaits, command)
        gait = optimize_gait(command, parameters=parameters, guess=guess, objective=objective)
        gaits.append(gait)
        if progress is not None:
            progress(index, len(checked), gait)
    return gaits


@signals_raised()
def optimize_transitions(gait: Gait) -> tuple[Transition, Transition]:
    """Optimise the stop of a gait in place after its left touchdown, and the start from that rest.

    Both feet stay where the gait puts them. The integral of the squared inputs over both motions is
    minimised; their durations and the height at rest are free, see `aslip.rom.stop_start`.

    Args:
        gait: gait at zero speed, of `optimize_gait` with one number or three; its model and bounds
            apply.

    Returns:
        Stop and start, with a common certificate without failures.

    Raises:
        ConfigurationError: the gait does not step in place.
        ShapeError: its number of collocation points is not the optimiser's.
        GaitOptimizationError: the solver found no solution, or a check failed.
        SolverError: as in `optimize_gait`.
    """
    problem, ends = stop_start_problem(gait.parameters), ends_of_gait(gait)
    solution, _, certificate = _solve(problem, ends, problem.rough_guess(ends))
    return transitions_from_modes(problem.modes(solution, ends), certificate, gait.parameters)


def _nearest(gaits: Sequence[Gait], command: np.ndarray) -> Gait | None:
    """Gait with the nearest command of equal length, the latest of several."""
    alike = [gait for gait in gaits if len(gait.command) == len(command)]
    distances = [np.linalg.norm(gait.command - command) for gait in reversed(alike)]
    return alike[-1 - int(np.argmin(distances))] if alike else None


def _checked(command: ArrayLike, p: SlipParameters) -> np.ndarray:
    """Check shape and range of a command; returns an array (1,) or (3,)."""
    numbers = np.atleast_1d(np.asarray(command, dtype=float))
    if numbers.shape == (1,):
        ranges = [("walking speed", 0.0, p.max_speed, "m/s")]
    elif numbers.shape == (3,):
        ranges = [
            ("forward speed", -p.max_backward_speed, p.max_speed, "m/s"),
            ("sideways speed", -p.max_sideways_speed, p.max_sideways_speed, "m/s"),
            ("yaw rate", -p.max_yaw_rate, p.max_yaw_rate, "rad/s"),
        ]
    else:
        raise ShapeError(
            "a command must be a forward speed or (forward speed, sideways speed, yaw rate), got"
            f" shape {np.shape(command)}"
        )
    for number, (name, low, high, unit) in zip(numbers.tolist(), ranges, strict=True):
        if not low <= number <= high:
            raise SpeedOutOfRangeError(
                f"{name} must be between {low:g} and {high:g} {unit}, got {number}"
            )
    return numbers


def _solve(
    problem: GaitProgram[_Solution], command: np.ndarray, start: _Solution
) -> tuple[_Solution, np.ndarray, Certificate]:
    """Solution, command and certificate of a problem."""
    opti = problem.opti
    opti.set_value(problem.command, command)
    # multipliers start from zero, so that the gait depends on the arguments alone
    opti.set_initial(opti.lam_g, 0.0)
    problem.start_from(start)
    began = time.perf_counter()
    try:
        opti.solve()
    except RuntimeError as error:
        raise _failure(problem, command, error) from None
    seconds = time.perf_counter() - began
    solution = problem.solution()
    certificate = certify(problem, solution, command, seconds)
    if not certificate.ok:
        raise GaitOptimizationError(
            f"{problem.title(command)} is not certified: {'; '.join(certificate.failures())}"
        )
    return solution, command, certificate


def _failure(
    problem: GaitProgram, command: np.ndarray, error: RuntimeError
) -> GaitOptimizationError | SolverError:
    """Error from the solver's status and last iterate, after CasADi raised an error."""
    opti = problem.opti
    try:
        status = opti.stats()["return_status"]
    except RuntimeError:  # an error before the solver's end
        status = str(error).rpartition("\n")[2]
    failure = f"no solution for {problem.title(command)}: IPOPT stopped with {status}"
    if status not in ABOUT_THE_PROBLEM:
        return SolverError(f"{failure}, which does not mean that there is none; try again")
    x, lam = opti.debug.value(opti.x), np.zeros(opti.ng)
    _, g, lower, upper = (v.full().ravel() for v in problem.optimality(x, lam, command))
    nearest = slacks(problem, g, lower, upper)
    worst = min(nearest, key=lambda name: nearest[name])
    return GaitOptimizationError(
        f"{failure} after {opti.stats()['iter_count']} iterations; worst constraint: {worst},"
        f" violated by {max(-nearest[worst], 0.0):.2e}"
    )
