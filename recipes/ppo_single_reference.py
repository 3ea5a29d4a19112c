"""Teach Cassie to walk by one reference motion, the method that the paper compares itself with.

    python recipes/ppo_single_reference.py                     # runs/ppo_single_reference/
    python recipes/ppo_single_reference.py --resume --total-steps 3000000

Xie et al. 2018 as the paper's authors used it: joint angles of one walking motion at every speed,
clock and speed as inputs, a reward in joint space (`aslip.stack.single_reference_stack`). Their
motion was recorded from another controller; ours is a linear inverted pendulum's in closed form.
Learning is that of `ppo_aslip.py`, so that only the guidance differs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import ppo_aslip
import tyro

from aslip.errors import AslipError
from aslip.evaluation import WalkResult
from aslip.transforms import SINGLE_REFERENCE_TABLE


@dataclass(frozen=True)
class Config(ppo_aslip.Config):
    """Settings of `ppo_aslip.py`."""

    out: Path = Path("runs/ppo_single_reference")
    """Folder of the run."""


def main(config: Config) -> list[WalkResult]:
    """Train, then evaluate at all speeds."""
    return ppo_aslip.main(config, stack="single_reference", observation=SINGLE_REFERENCE_TABLE)


if __name__ == "__main__":
    try:
        main(tyro.cli(Config))
    except AslipError as error:
        raise SystemExit(f"error: {error}") from None
