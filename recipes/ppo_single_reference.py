"""Teach Cassie to walk by one reference motion, the method that the paper compares itself with.

    python recipes/ppo_single_reference.py                     # runs/ppo_single_reference/
    python recipes/ppo_single_reference.py --resume --total-steps 3000000

Xie et al. 2018 as the paper's authors used it: joint angles of one walking motion at every speed,
clock and speed as inputs, a reward in joint space (`aslip.stack.single_reference_stack`). Their
motion was recorded from another controller; ours is a linear inverted pendulum's in closed form.
Learning is that of `ppo_aslip.py`, so that only the guidance differs; but an episode has one speed,
as there, because where the pelvis should be cannot be caught up with after a change.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import ppo_aslip

from aslip.errors import one_line_errors

PRESETS = {
    name: replace(
        config,
        stack="single_reference",
        out=Path("runs/ppo_single_reference"),
        command_interval=0.0,
    )
    for name, config in ppo_aslip.PRESETS.items()
}

if __name__ == "__main__":
    with one_line_errors():
        ppo_aslip.main(ppo_aslip.command_line(PRESETS))
