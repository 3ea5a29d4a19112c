"""Walks of a policy: recording, evaluation, interactive control (`walker`), metrics.

`metrics` are pure functions of arrays; `tables` writes Markdown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.walking.evaluation import (
        TRACKING_TOLERANCE,
        WalkResult,
        evaluate,
        evaluation_means,
        is_on_feet,
        tracks_command,
        walk_table,
    )
    from aslip.walking.interval import CONFIDENCE, Interval
    from aslip.walking.push import Push, policy_steps
    from aslip.walking.record import (
        Walks,
        next_start,
        record_walks,
        reset_walks,
        take_step,
        walk,
    )
    from aslip.walking.substeps import Substeps, record_substeps
    from aslip.walking.tables import markdown
    from aslip.walking.walker import Walker, command_library

__all__ = [
    "CONFIDENCE",
    "TRACKING_TOLERANCE",
    "Interval",
    "Push",
    "Substeps",
    "WalkResult",
    "Walker",
    "Walks",
    "command_library",
    "evaluate",
    "evaluation_means",
    "is_on_feet",
    "markdown",
    "next_start",
    "policy_steps",
    "record_substeps",
    "record_walks",
    "reset_walks",
    "take_step",
    "tracks_command",
    "walk",
    "walk_table",
]

__getattr__, __dir__ = attach(
    __name__,
    {
        "evaluation": [
            "TRACKING_TOLERANCE",
            "WalkResult",
            "evaluate",
            "evaluation_means",
            "is_on_feet",
            "tracks_command",
            "walk_table",
        ],
        "interval": ["CONFIDENCE", "Interval"],
        "record": [
            "Walks",
            "next_start",
            "record_walks",
            "reset_walks",
            "take_step",
            "walk",
        ],
        "push": ["Push", "policy_steps"],
        "substeps": ["Substeps", "record_substeps"],
        "tables": ["markdown"],
        "walker": ["Walker", "command_library"],
    },
)
