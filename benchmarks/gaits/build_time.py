"""Time of gait optimisation and inverse kinematics on one core.

    python -m benchmarks.gaits.build_time

Each measurement is a fresh Python process on one core and one thread, so that imports and solver
construction count; table rows are medians over processes. The inverse kinematics solves positions
and velocities of all poses of the library; only the solution is timed.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    rounds: int = 5
    """Number of processes; the table shows the median."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import os
import statistics
import subprocess
import sys
import time

from aslip.base.tables import markdown

_GAITS = """
from aslip.library import PAPER_SPEEDS
from aslip.rom import optimize_gaits
gaits = optimize_gaits(PAPER_SPEEDS)
assert all(gait.certificate.ok for gait in gaits)
"""

_POSES = """
import time
import numpy as np
from aslip.ik import BodyTarget, Kinematics, solve
from aslip.library import GaitLibrary
from aslip.rom import Track

phase = np.arange(128) / 128
samples = [motion.sample(phase) for motion in GaitLibrary.load().motions]
tracks = [
    [sample.body for sample in samples],
    *([Track(s.feet.position[:, i], s.feet.velocity[:, i]) for s in samples] for i in range(2)),
]

def target(tracks):
    position = np.concatenate([track.position for track in tracks])
    return BodyTarget(position, velocity=np.concatenate([track.velocity for track in tracks]))

targets = [target(track) for track in tracks]
kinematics = Kinematics()
start = time.perf_counter()
solution = solve(kinematics, *targets)
seconds = time.perf_counter() - start
print(len(solution.qpos), seconds, solution.residual.loop, solution.residual.foot_position)
"""


def main(config: Config) -> None:
    """Measure and print."""
    seconds, outputs = [], []
    for _ in range(config.rounds):
        start = time.perf_counter()
        _run(_GAITS)
        seconds.append(time.perf_counter() - start)
        outputs.append([float(word) for word in _run(_POSES).split()])
    count, _, loop, foot = outputs[0]
    rate = count / statistics.median(output[1] for output in outputs)
    rows = [
        ["21 gaits from a cold start", f"{statistics.median(seconds):.1f} s"],
        [f"inverse kinematics of {count:.0f} poses", f"{rate:.0f} poses/s"],
        ["largest loop-closure error", f"{loop:.0e} m"],
        ["largest foot position error", f"{foot:.0e} m"],
    ]
    print(markdown(["on one core", "result"], rows, ["---", "---:"]))


def _run(code: str) -> str:
    """Standard output of a Python process on one core."""
    return subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=_bind_to_one_core if hasattr(os, "sched_setaffinity") else None,
    ).stdout


def _bind_to_one_core() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
