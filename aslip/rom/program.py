"""Nonlinear program of a periodic gait: named constraints, solver, optimality conditions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Generic, TypeVar, get_args

import casadi as ca
import numpy as np

from aslip.errors import ConfigurationError
from aslip.rom import collocation
from aslip.rom.slip import Mode, Objective, SlipParameters

INTERVALS = 25
"""Hermite-Simpson intervals per contact mode: 51 points; the published gaits have 50."""

IPOPT_OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 500,
    # all below the 1e-8 that a certificate asks for, on the unscaled problem too
    "tol": 1e-10,
    "dual_inf_tol": 1e-9,
    "constr_viol_tol": 1e-10,
    "compl_inf_tol": 1e-10,
    # bounds are kept exactly, not relaxed by 1e-8
    "bound_relax_factor": 0.0,
    # stop rather than accept a gait of lower accuracy
    "acceptable_iter": 0,
}


@dataclass(frozen=True)
class ModeSolution:
    """Solution within one contact mode at its 2 N + 1 collocation points."""

    mode: Mode
    """Contact mode."""
    state: np.ndarray
    """(10, 2 N + 1) states."""
    control: np.ndarray
    """(2, 2 N + 1) inputs [m/s^2]."""
    feet: tuple[np.ndarray, np.ndarray]
    """Positions of left and right foot (3,) [m]; that of a swing foot has no meaning."""
    duration: float
    """Duration of the mode [s]."""


Solution = TypeVar("Solution")
"""Values of all variables of a program, by name of the variable."""


class GaitProgram(ABC, Generic[Solution]):
    """Nonlinear program of the most economical gait, with the command as its only parameter.

    Attributes:
        opti: CasADi problem; its solver is silent.
        command: parameter of `opti`.
        constraints: (name, number of rows) in the order of the rows.
    """

    _variables: type[Solution]

    def __init__(self, parameters: SlipParameters, objective: Objective = "mean") -> None:
        if objective not in get_args(Objective):
            raise ConfigurationError(
                f"objective must be one of {get_args(Objective)}, got {objective!r}"
            )
        self.parameters = parameters
        self.objective = objective
        self.opti = ca.Opti()
        self.constraints: list[tuple[str, int]] = []
        self.command: ca.MX
        self._formulate()
        self.opti.solver("ipopt", {"expand": True, "print_time": False}, IPOPT_OPTIONS)

    @abstractmethod
    def _formulate(self) -> None:
        """Declare variables, objective and constraints."""

    def solution(self) -> Solution:
        """Values of all variables after a successful solve."""
        values = {
            field.name: self.opti.value(getattr(self, field.name))
            for field in fields(self._variables)  # pyright: ignore[reportArgumentType]
        }
        return self._variables(**values)

    @abstractmethod
    def modes(self, solution: Solution, command: np.ndarray) -> Sequence[ModeSolution]:
        """Consecutive contact modes of a solution."""

    def title(self, command: np.ndarray) -> str:
        """Name of the problem at a command (c,), for error messages."""
        units = ("m/s forward", "m/s sideways", "rad/s") if len(command) > 1 else ("m/s",)
        values = (f"{number:g} {unit}" for number, unit in zip(command, units, strict=True))
        return f"the gait at {', '.join(values)}"

    @cached_property
    def optimality(self) -> ca.Function:
        """CasADi function (variables, multipliers, command) -> (stationarity, g, lower, upper).

        Stationarity is the gradient of f + multipliers . g; g must lie between the bounds.
        """
        opti = self.opti
        gradient = ca.gradient(opti.f + ca.dot(opti.lam_g, opti.g), opti.x)
        bounds = [ca.densify(opti.lbg), ca.densify(opti.ubg)]
        return ca.Function("optimality", [opti.x, opti.lam_g, opti.p], [gradient, opti.g, *bounds])

    def start_from(self, guess: Solution) -> None:
        """Set every variable's initial value to the field of a guess with its name."""
        for name, value in vars(guess).items():
            self.opti.set_initial(getattr(self, name), value)

    def _require(self, name: str, value: ca.MX, constraint: ca.MX) -> None:
        self.constraints.append((name, value.numel()))
        self.opti.subject_to(constraint)


def effort(control: ca.MX) -> ca.MX:
    """Simpson sum of u_l^2 + u_r^2 for intervals of unit duration."""
    return ca.sum1(control**2) @ ca.DM(collocation.weights(INTERVALS))
