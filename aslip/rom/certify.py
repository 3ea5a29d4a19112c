"""Checks on a solved problem: optimality conditions, re-integration, margins."""

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from aslip.rom import collocation
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import flow_function
from aslip.rom.program import GaitProgram, ModeSolution, Solution
from aslip.rom.slip import Mode, SlipParameters

_RELATIVE, _ABSOLUTE = 1e-10, 1e-12
"""Tolerances of the adaptive integrator, far below the error that a certificate allows."""


def kkt_residual(
    gradient: np.ndarray, g: np.ndarray, lower: np.ndarray, upper: np.ndarray, lam: np.ndarray
) -> float:
    """Largest violation of stationarity, feasibility and complementarity, all unscaled.

    Args:
        gradient: gradient of the Lagrangian (variables,).
        g: constraint values (rows,).
        lower: their lower bounds, -inf where there is none.
        upper: their upper bounds, inf where there is none.
        lam: multipliers (rows,), positive at an upper bound and negative at a lower one.
    """
    infeasible = np.maximum(np.maximum(lower - g, g - upper), 0.0)
    slack = np.where(lam > 0.0, upper - g, g - lower)
    # without a bound on that side the multiplier itself is the violation
    products = np.where(np.isfinite(slack), lam * slack, lam)
    return float(max(np.abs(gradient).max(), infeasible.max(), np.abs(products).max()))


def integrate_mode(
    mode: Mode,
    start: np.ndarray,
    control: np.ndarray,
    feet: tuple[np.ndarray, np.ndarray],
    duration: float,
    p: SlipParameters,
) -> np.ndarray:
    """State (10,) at the end of a mode, by adaptive integration (DOP853) from its first point.

    Args:
        mode: contact mode.
        start: first state (10,).
        control: inputs at the collocation points (2, 2 N + 1) [m/s^2], quadratic per interval.
        feet: positions of left and right foot (3,) [m].
        duration: duration of the mode [s].
        p: model parameters.
    """
    flow, state = flow_function(mode, p), start
    intervals = control.shape[1] // 2
    h = duration / intervals
    for i in range(intervals):
        # restart at each interval, where the input has a corner
        piece = control[:, 2 * i : 2 * i + 3]

        def rate(t: float, x: np.ndarray, piece: np.ndarray = piece) -> np.ndarray:
            return flow(x, collocation.quadratic(piece, t / h), *feet).full().ravel()

        run = solve_ivp(rate, (0.0, h), state, "DOP853", rtol=_RELATIVE, atol=_ABSOLUTE)
        state = run.y[:, -1]
    return state


def integration_error(modes: Sequence[ModeSolution], p: SlipParameters) -> float:
    """Largest error of the body position at the end of a mode [m].

    Consecutive modes are integrated in one go, from the first state of the first one.
    """
    state, errors = modes[0].state[:, 0], []
    for m in modes:
        state = integrate_mode(m.mode, state, m.control, m.feet, m.duration, p)
        errors.append(np.linalg.norm(state[:3] - m.state[:3, -1]))
    return float(max(errors))


def rows(problem: GaitProgram) -> dict[str, slice]:
    """Name of each group of constraints -> its rows in the problem's g."""
    ends = np.cumsum([count for _, count in problem.constraints])
    return {
        name: slice(end - count, end)
        for (name, count), end in zip(problem.constraints, ends.tolist(), strict=True)
    }


def slacks(
    problem: GaitProgram, g: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> dict[str, float]:
    """Name of each group of constraints -> distance to its nearest bound, negative if violated.

    Forces are scaled by body weight, as in the problem; equalities give minus their largest gap.
    """
    nearest = np.minimum(g - lower, upper - g)
    return {name: float(nearest[part].min()) for name, part in rows(problem).items()}


def certify(
    problem: GaitProgram[Solution], solution: Solution, command: np.ndarray, seconds: float
) -> Certificate:
    """Certificate of a problem that has just been solved.

    Args:
        problem: problem whose solver has just succeeded.
        solution: its solution.
        command: (c,) its command.
        seconds: wall-clock time the solver took [s].
    """
    opti, stats, p = problem.opti, problem.opti.stats(), problem.parameters
    lam = np.ravel(opti.value(opti.lam_g))
    values = problem.optimality(opti.value(opti.x), lam, command)
    gradient, g, lower, upper = (value.full().ravel() for value in values)
    nearest = slacks(problem, g, lower, upper)
    margins = {n: s * (p.weight if "force" in n else 1.0) for n, s in nearest.items()}
    equalities = {n for n, part in rows(problem).items() if (lower[part] == upper[part]).all()}
    return Certificate(
        solver_status=stats["return_status"],
        iterations=stats["iter_count"],
        solve_time=seconds,
        cost=float(opti.value(opti.f)),
        kkt_residual=kkt_residual(gradient, g, lower, upper, lam),
        max_defect=max(-slack for name, slack in nearest.items() if "defect" in name),
        integration_error=integration_error(problem.modes(solution, command), p),
        margins={name: m for name, m in margins.items() if name not in equalities},
    )
