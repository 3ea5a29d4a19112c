"""Certificate that a gait is optimal and feasible and obeys the dynamics."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

SOLVED = "Solve_Succeeded"
"""IPOPT's status for a problem solved to the requested tolerance."""
KKT_TOLERANCE = 1e-8
"""Largest KKT residual of a certified gait."""
DEFECT_TOLERANCE = 1e-8
"""Largest collocation defect of a certified gait [state units]."""
INTEGRATION_TOLERANCE = 1e-4
"""Largest distance between collocated and integrated body position at the end of a mode [m]."""
MARGIN_TOLERANCE = 1e-8
"""Largest violation of a bound in a certified gait [units of the bound]."""


_SIDES = {"left": "right", "right": "left"}


@dataclass(frozen=True)
class Certificate:
    """Residuals, errors and margins of a solved problem."""

    solver_status: str
    """IPOPT's return status."""
    iterations: int
    """Interior-point iterations."""
    solve_time: float
    """Wall-clock time in the solver [s]; the one number that differs from run to run."""
    cost: float
    """Value of the minimised objective: by default the mean of u_l^2 + u_r^2 [m^2/s^4]."""
    kkt_residual: float
    """Largest violation of the first-order conditions by the primal-dual solution.

    Recomputed from the solver's final point, unscaled: the infinity norms of the gradient of the
    Lagrangian, of the constraint violation, and of multiplier times slack.
    """
    max_defect: float
    """Largest Hermite-Simpson defect over all intervals and states [state units]."""
    integration_error: float
    """Largest error of the body position at the end of a contact mode [m].

    The modes are integrated in one go, from the first point of the stride, with an adaptive
    eighth-order Runge-Kutta method and the piecewise quadratic input of the collocation.
    """
    margins: Mapping[str, float]
    """Distance to each bound at the closest collocation point, negative where violated.

    Leg force [N], leg lengths, body height, set point and distance of the feet [m], double stance
    [s].
    """

    def __post_init__(self) -> None:
        """Keep a copy of the margins."""
        object.__setattr__(self, "margins", dict(self.margins))

    @property
    def ok(self) -> bool:
        """True if every check succeeds."""
        return not self.failures()

    def failures(self) -> list[str]:
        """One sentence per failed check; empty for a certified gait."""
        limits = {
            "kkt_residual": KKT_TOLERANCE,
            "max_defect": DEFECT_TOLERANCE,
            "integration_error": INTEGRATION_TOLERANCE,
        }
        # "not below" rather than "above", so that a NaN fails
        failed = [
            f"{name} is {getattr(self, name):.2e}, above {limit:.0e}"
            for name, limit in limits.items()
            if not getattr(self, name) <= limit
        ]
        failed += [
            f"{name} violates its bound by {-margin:.2e}"
            for name, margin in self.margins.items()
            if not margin >= -MARGIN_TOLERANCE
        ]
        if self.solver_status != SOLVED:
            failed.insert(0, f"the solver stopped with {self.solver_status}")
        return failed

    def mirrored(self) -> "Certificate":
        """Certificate of the mirror image: left and right exchanged in the names of the margins."""
        names = {" ".join(_SIDES.get(word, word) for word in n.split(" ")): n for n in self.margins}
        return replace(self, margins={image: self.margins[n] for image, n in names.items()})

    def to_json(self) -> str:
        """One line of JSON; floats survive the round trip exactly."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Certificate":
        """Certificate from the text of `to_json`.

        Raises:
            ValueError: the text is not JSON.
            TypeError: a field is missing or unknown.
        """
        return cls(**json.loads(text))
