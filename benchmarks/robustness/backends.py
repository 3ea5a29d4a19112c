"""Agreement of simulators: the same policy at the same commands on each.

    python -m benchmarks.robustness.backends
    python -m benchmarks.robustness.backends --policy directions --device cuda

Walks begin alike and differ by rounding, which contacts amplify. Differences are means over the
commands, paired by command, with 95 % intervals; walks that end in a fall count, too.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Common, check_numbers


@dataclass(frozen=True)
class Config(Common):
    """Settings of the benchmark."""

    policy: tuple[str, ...] = ("straight", "directions")
    """Policies to walk: names, files or run folders."""
    device: str = "cpu"
    """Device of the robots on MuJoCo Warp."""
    steps: int = 400
    """Policy steps of a walk."""

    def __post_init__(self) -> None:
        """Check the number of steps."""
        super().__post_init__()
        check_numbers(self, steps=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import copy
from dataclasses import asdict
from typing import Any

import numpy as np

from aslip.base.interval import Interval
from aslip.training.environments import make_evaluation_env
from aslip.walking import WalkResult, evaluate
from benchmarks.common import Policies, Report, Subject, benchmark, table

COLUMNS = {
    "policy": "{policy}",
    "walks": "{walks}",
    "survived: batch, warp": "{survived}",
    "mean return: batch, warp": "{returns}",
    **{
        header: lambda row, name=name, digits=digits: Interval(**row[name]).text(digits)
        for header, name, digits in (
            ("difference of return", "total", 2),
            ("of speed [m/s]", "mean_speed", 3),
            ("of force over weight", "weight_ratio", 4),
        )
    },
}


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Walk and compare; the result is a row for each policy."""
    subjects = [subject for method in policies.methods().values() for subject in method]
    rows = [_compared(config, subject) for subject in subjects]
    return Report(rows, table(COLUMNS, rows))


def _compared(config: Config, subject: Subject) -> dict[str, Any]:
    batch, warp = (_walks(config, subject, backend) for backend in ("batch", "warp"))

    def difference(name: str) -> dict[str, float]:
        pairs = zip(batch, warp, strict=True)
        differences = np.array([getattr(b, name) - getattr(a, name) for a, b in pairs])
        return asdict(Interval.of([differences]))

    def both(name: str, form: str) -> str:
        values = (float(np.mean([getattr(w, name) for w in walks])) for walks in (batch, warp))
        return ", ".join(form.format(value) for value in values)

    return {
        "policy": subject.name,
        "walks": len(batch),
        "survived": ", ".join(str(sum(w.survived for w in walks)) for walks in (batch, warp)),
        "returns": both("total", "{:.1f}"),
        **{name: difference(name) for name in ("total", "mean_speed", "weight_ratio")},
    }


def _walks(config: Config, subject: Subject, backend: str) -> list[WalkResult]:
    settings = {"backend": backend} | ({"device": config.device} if backend == "warp" else {})
    env, commands = make_evaluation_env(
        lambda num_envs, seed: subject.env(num_envs, seed=seed, **settings), config.seed
    )
    policy = copy.deepcopy(subject.policy).to(env.place)
    return evaluate(policy, env, commands, config.steps)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
