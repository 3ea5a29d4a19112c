"""Teach Cassie to walk by one reference motion, the method that the paper compares itself with.

    python recipes/ppo_single_reference.py                     # runs/ppo_single_reference/
    python recipes/ppo_single_reference.py --resume --total-steps 8000000

Xie et al. 2018 as the paper's authors used it: joint angles of one walking motion at every speed,
clock and speed as inputs, a reward in joint space (`aslip.envs.single_reference_stack`). Their
motion was recorded from another controller; ours is a linear inverted pendulum's in closed form.
Learning is with the paper's settings, but for exploration and learning rate, which fall in the end:
without, policies differ from one update to the next in which speeds they walk. With the default of
`ppo_aslip.py` speeds are obeyed, by steps with two humps of force. An episode has one speed, as
there, because where the pelvis should be cannot be caught up with after a change.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from aslip.errors import one_line_errors
from aslip.training import ppo_settings

_PAPER = replace(
    ppo_settings.PRESETS["paper"],
    stack="single_reference",
    out=Path("runs/ppo_single_reference"),
)

PRESETS = {
    "default": replace(
        _PAPER,
        preset="default",
        total_steps=6_250_000,
        fall_after=0.8,
        last_learning_rate=1e-5,
        last_std=0.05,
    ),
    "paper": _PAPER,
}

if __name__ == "__main__":
    config = ppo_settings.training_settings(PRESETS)

    # after the command line is parsed, as it takes seconds
    import ppo_aslip

    with one_line_errors():
        ppo_aslip.main(config, go_on=ppo_settings.resume_command(config))
