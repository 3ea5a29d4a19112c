"""Claims of the paper's results: sentences, published values, and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from aslip.walking import TRACKING_TOLERANCE


@dataclass(frozen=True)
class Claim:
    """Claim, and the limit that its value must meet."""

    name: str
    sentence: str
    """Sentence of the paper with its section, or requirement of this project."""
    published: str
    """Published value; empty if there is none."""
    unit: str
    at_least: float = -math.inf
    """Smallest value for which the claim holds."""
    at_most: float = math.inf
    """Largest value for which the claim holds."""
    digits: int = 2
    """Digits of the value in the table."""

    @property
    def limit(self) -> str:
        """Limit as text."""
        if math.isfinite(self.at_least):
            return f"≥ {self.at_least:g}"
        return f"≤ {self.at_most:g}"


CLAIMS: Final = (
    Claim(
        "samples",
        "V: learns to step in place after about 25 million timesteps",
        "25",
        "million",
        at_most=25,
    ),
    Claim(
        "return",
        "V: converges to a reward of almost 300",
        "almost 300",
        "",
        at_least=300,
        digits=0,
    ),
    Claim("training time", "V: just under five hours on 50 cores", "5", "h", at_most=5),
    Claim(
        "all speeds",
        "V: able to track all of the walk cycles in the library; survived on its feet,"
        f" mean speed within {TRACKING_TOLERANCE:g} m/s",
        "all",
        "of 21",
        at_least=21,
        digits=1,
    ),
    Claim(
        "velocity tracking",
        "V-A: succeeds across the broad set of commanded speeds; largest error over speeds",
        "0.02",
        "m/s",
        at_most=0.05,
        digits=3,
    ),
    Claim("slow walking", "obeys commands of 0 to 0.3 m/s", "", "m/s", at_most=0.05, digits=3),
    Claim(
        "smooth transitions",
        "V-A: smoothly transition between reference walk cycles; step changes survived",
        "all",
        "of 6",
        at_least=6,
        digits=1,
    ),
    Claim("settling", "slowest settling time after steps of 1 m/s", "", "s", at_most=1.5),
    Claim(
        "velocity oscillation",
        "V-A: oscillations in pelvis velocity correspond to the model's; correlation",
        "",
        "",
        at_least=0.5,
    ),
    Claim(
        "touchdown spikes",
        "Fig. 5: does not emulate the spikes at touchdown; ratio of robot to model",
        "",
        "",
        at_most=0.5,
    ),
    Claim(
        "wider feet",
        "V-A: at all speeds places its feet slightly wider; smallest offset",
        "1.5",
        "cm",
        at_least=0,
        digits=1,
    ),
    Claim(
        "feet below 1 m/s",
        "V-A: under 1.0 m/s the placement error does not exceed 10 cm",
        "9.2",
        "cm",
        at_most=10,
        digits=1,
    ),
    Claim(
        "feet above 1 m/s",
        "V-A: above 1.0 m/s footsteps lag more and more; increase of the error to 2.0 m/s",
        "34",
        "cm",
        at_least=0,
        digits=1,
    ),
    Claim("feet to 1.0 m/s", "largest mean error up to 1.0 m/s", "9.2", "cm", at_most=3, digits=1),
    Claim("feet at 1.5 m/s", "mean error", "24.5", "cm", at_most=5, digits=1),
    Claim("feet at 2.0 m/s", "mean error", "43.2", "cm", at_most=8, digits=1),
    Claim(
        "double hump",
        "V-A: double hump ground force at 0 and 1.0 m/s; largest dip ratio",
        "0.67",
        "",
        at_most=0.7,
    ),
    Claim(
        "baseline's single hump",
        "V-A: single flattened hump for all speeds; smallest dip ratio",
        "0.92",
        "",
        at_least=0.9,
    ),
    Claim(
        "springy legs",
        "V-B: changes in leg length directly correspond to the model's; correlation",
        "",
        "",
        at_least=0.5,
    ),
    Claim(
        "step frequency",
        "V-B: stepping frequency matches; largest difference over speeds",
        "0",
        "%",
        at_most=2,
    ),
)
"""Claims in the order of the table."""
