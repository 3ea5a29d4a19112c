r"""Hermite-Simpson collocation: states and inputs at the nodes and midpoints of equal intervals.

Arrays have one column per collocation point: node, midpoint, node, ..., node; 2 N + 1 columns for N
intervals. The state is a cubic and the input a quadratic on each interval: a state that is a cubic
in time has no defect, and the integral of a cubic is exact.
"""

from typing import Any

import casadi as ca
import numpy as np


def defects(state: Any, derivative: Any, interval: Any) -> Any:
    r"""Gaps between the state and its Hermite-Simpson prediction, zero when collocated.

    .. math::
        \mathbf x_m = \tfrac12(\mathbf x_0 + \mathbf x_1) + \tfrac h8(\mathbf f_0 - \mathbf f_1),
        \qquad \mathbf x_1 = \mathbf x_0 + \tfrac h6(\mathbf f_0 + 4\mathbf f_m + \mathbf f_1)

    Args:
        state: (k, 2 N + 1) states at nodes and midpoints, any CasADi matrix type.
        derivative: (k, 2 N + 1) their time derivatives according to the dynamics.
        interval: duration h of one interval [s].

    Returns:
        (2 k, N), first the k midpoint gaps and then the k end gaps of each interval.
    """
    # CasADi misreads a negative stop with a step on a matrix of one row
    last = state.shape[1] - 1
    x0, xm, x1 = state[:, 0:last:2], state[:, 1::2], state[:, 2::2]
    f0, fm, f1 = derivative[:, 0:last:2], derivative[:, 1::2], derivative[:, 2::2]
    middle = xm - (x0 + x1) / 2 - interval / 8 * (f0 - f1)
    end = x1 - x0 - interval / 6 * (f0 + 4 * fm + f1)
    return ca.vertcat(middle, end)


def weights(intervals: int) -> np.ndarray:
    """Simpson weights of the 2 N + 1 points for a unit interval, (2 N + 1,); they sum to N."""
    weight = np.full(2 * intervals + 1, 2.0)
    weight[1::2] = 4.0
    weight[[0, -1]] = 1.0
    return weight / 6.0


def quadratic(values: np.ndarray, fraction: float) -> np.ndarray:
    """Input inside an interval: the parabola through start, middle and end.

    Args:
        values: (k, 3) input at start, middle and end of the interval.
        fraction: position in the interval, 0 at the start and 1 at the end.

    Returns:
        (k,) input.
    """
    s = fraction
    return values @ np.array([(2 * s - 1) * (s - 1), 4 * s * (1 - s), s * (2 * s - 1)])
