"""Small library with stop and start, over three commands."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import aslip
from aslip.library import GaitLibrary, tabulate_transitions
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, policy_interface, save_policy
from aslip.rom import optimize_transitions
from tests.library.bent import Bent


@cache
def standing_library() -> GaitLibrary:
    """Library of 0 and 0.5 m/s, -0.5 to 0.5 rad/s, bent from straight gaits, with transitions."""
    gaits = GaitLibrary.load().gaits
    motions = [Bent(gaits[i], 0.0, w) for i in (0, 5) for w in (-0.5, 0.0, 0.5)]
    transitions = tabulate_transitions(gaits[0], optimize_transitions(gaits[0]), samples=24)
    return GaitLibrary.from_motions(motions, samples=32, transitions=transitions)


def slower_library() -> GaitLibrary:
    """Library of `standing_library` with a stop and a start that take twice as long."""
    library = standing_library()
    assert library.transitions is not None
    slower = replace(library.transitions, durations=2 * library.transitions.durations)
    return GaitLibrary(library.motions, library.table, transitions=slower)


def policy_files(
    folder: Path, library: GaitLibrary, stack: str = "directions"
) -> tuple[Path, Path]:
    """Library, and untrained policy of a stack for all directions, in a folder."""
    library.save(folder / "gaits.npz")
    env = aslip.make_env(stack=stack, library=library, num_threads=1, seed=0)  # pyright: ignore
    interface, shape = policy_interface(env), PolicyShape(82)
    actor = make_actor(RunningNormalizer(82), shape, interface["observation"])
    save_policy(folder / "policy.zip", actor, shape, **interface)
    return folder / "gaits.npz", folder / "policy.zip"
