"""Small library with stop and start, over three commands."""

from __future__ import annotations

from functools import cache

from aslip.library import GaitLibrary, tabulate_transitions
from aslip.rom import optimize_transitions
from tests.library.bent import Bent


@cache
def standing_library() -> GaitLibrary:
    """Library of 0 and 0.5 m/s, -0.5 to 0.5 rad/s, bent from straight gaits, with transitions."""
    gaits = GaitLibrary.load().gaits
    motions = [Bent(gaits[i], 0.0, w) for i in (0, 5) for w in (-0.5, 0.0, 0.5)]
    transitions = tabulate_transitions(gaits[0], optimize_transitions(gaits[0]), samples=24)
    return GaitLibrary.from_motions(motions, samples=32, transitions=transitions)
