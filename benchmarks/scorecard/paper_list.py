"""Sentences of the paper's results, and targets of walks straight ahead, with their limits."""

from __future__ import annotations

from typing import Final

from aslip.walking import TRACKING_TOLERANCE
from benchmarks.scorecard.verdicts import Claim

SENTENCES: Final = (
    Claim(
        "samples",
        "policy steps until training episodes last 350 of 400 steps [million]; another criterion"
        " than the paper's stepping in place",
        'V: "learns to step in place after about 25 million timesteps"',
        published="25",
        at_most=25,
        ours=False,
    ),
    Claim(
        "return",
        "mean return of training episodes, with exploration noise (less of it in `straight`), at"
        " the end of the training; the paper trains longer, and does not mention noise",
        'V: "converges to a reward of almost 300 after about 175 million timesteps"',
        published="almost 300",
        released="318",
        at_least=300,
        ours=False,
        digits=0,
    ),
    Claim(
        "training time",
        "time until training episodes return 300 [h]; on other hardware, one core a training",
        'V: "takes just under five hours of wall clock time using 50 cores"',
        published="5",
        at_most=5,
        ours=False,
    ),
    Claim(
        "all speeds",
        f"speeds, of 21, survived on the feet with a mean speed within {TRACKING_TOLERANCE:g} m/s;"
        " worst seed counts",
        'V: "able to track all of the walk cycles in the reduced-order model library"',
        published="all",
        at_least=21,
        every_seed=True,
        ours=False,
        digits=1,
    ),
    Claim(
        "velocity tracking",
        "largest error of the mean speed at 21 speeds [m/s]; the paper's at six speeds, the"
        " released policies' at five",
        'V-A: "this velocity tracking succeeds across the broad set of commanded speeds"',
        published="0.02",
        released="0.08, 0.10",
        at_most=0.05,
        digits=3,
    ),
    Claim(
        "smooth transitions",
        "step changes of the command, of six, after which the speed settles within 0.1 m/s; worst"
        " seed counts",
        'V-A: "ability to smoothly transition between discrete reference walk cycles"',
        at_least=6,
        every_seed=True,
        digits=1,
    ),
    Claim(
        "velocity oscillation",
        "correlation of pelvis velocity with the model's body velocity",
        'V-A: "oscillations in pelvis velocity that correspond with the oscillations in center of'
        ' mass velocity from the reduced-order model"',
        at_least=0.5,
    ),
    Claim(
        "touchdown spikes",
        "range of speed around the model's touchdowns, robot over model",
        "Fig. 5: \"does not emulate the spikes in reduced-order model's body velocity which occur"
        ' at touchdown"',
        at_most=0.5,
    ),
    Claim(
        "wider feet",
        "smallest mean outward offset over speeds [cm]",
        'V-A: "at all speeds, we observe that the robot places its feet slightly wider than the'
        ' reduced-order model"',
        published="1.5",
        at_least=0,
        strict=True,
        ours=False,
        digits=1,
    ),
    Claim(
        "feet below 1 m/s",
        "largest mean error of 15 footsteps at speeds below 1.0 m/s [cm]; released: at 0 and"
        " 0.5 m/s",
        'V-A: "at speeds under 1.0 m/s this placement error doesn\'t exceed an average of 10 cm"',
        published="7.2",
        released="5.5, 4.5",
        at_most=10,
        ours=False,
        digits=1,
    ),
    Claim(
        "feet lag",
        "mean forward error at 2.0 m/s minus that at 1.0 m/s, negative if feet lag [cm]; published:"
        " one walk that stays below 0.95 m/s",
        'V-A: "above 1.0 m/s, we see that the robot\'s footsteps lag more and more"',
        published="-34",
        at_most=0,
        strict=True,
        ours=False,
        digits=1,
    ),
    Claim(
        "double hump",
        "dip ratio, larger one of 0 and 1.0 m/s; worst seed counts",
        'V-A: "at 0 and 1.0 m/s the actuated SLIP policy has a double hump ground reaction force"',
        published="0.67",
        at_most=0.7,
        every_seed=True,
        fed_forward=True,
    ),
    Claim(
        "baseline's single hump",
        "dip ratio of the baseline, smallest of 0, 1.0 and 2.0 m/s; worst seed counts",
        'V-A: "the single reference trajectory has a single hump ground reaction force with a'
        ' flattened peak for all speeds"',
        published="0.92",
        at_least=0.9,
        every_seed=True,
        on_baseline=True,
    ),
    Claim(
        "springy legs",
        "correlation of leg length with the model's; in simulation, the paper's sentence is about"
        " hardware",
        'V-B: "changes in leg length directly corresponding to the same variations in the motion'
        ' of the reduced-order model"',
        at_least=0.5,
        fed_forward=True,
    ),
    Claim(
        "step frequency",
        "largest difference from the model's over speeds [%]; simulation and model only, no"
        " hardware",
        'V-B: "the stepping frequency of all three stages [...] match for the same forward'
        ' velocity commands"',
        at_most=2,
    ),
)
"""Sentences of the paper in its order; tested on the paper's settings."""

TARGETS: Final = (
    Claim(
        "evaluation return",
        "mean return of walks at 21 speeds without exploration noise; not a learning curve, as the"
        " paper's is",
        released="338",
        at_least=320,
        digits=0,
    ),
    Claim("settling", "slowest settling time after steps of 1 m/s [s]", at_most=1.5),
    Claim(
        "feet to 1.0 m/s",
        "largest mean error of 15 footsteps at speeds up to 1.0 m/s, this one included [cm];"
        " released: at 0, 0.5 and 1.0 m/s",
        published="9.2",
        released="7.7, 7.6",
        at_most=3,
        digits=1,
    ),
    Claim(
        "feet at 1.5 m/s",
        "mean error of 15 footsteps [cm]; published: one walk that stays below 0.95 m/s",
        published="24.5",
        released="9.3, 11.2",
        at_most=5,
        digits=1,
    ),
    Claim(
        "feet at 2.0 m/s",
        "mean error of 15 footsteps [cm]; published: one walk that stays below 0.95 m/s",
        published="43.2",
        released="13.4, 13.5",
        at_most=8,
        digits=1,
    ),
)  # fmt: skip
"""Targets of this project; tested on the settings of `straight`."""
