"""Logs of rollouts: one self-contained MCAP file that viewers show and simulations replay.

    recorder = Recorder("walk.mcap", policy="straight")     # last transform of a stack
    recording = read("walk.mcap")                           # arrays by topic and name
    recover("walk.mcap.part"), replay("walk.mcap")

From a shell: `python -m aslip.log info | check | recover | replay --verify`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.log.playback import Replay, replay
    from aslip.log.reader import Recording, Series, read
    from aslip.log.recorder import Recorder
    from aslip.log.recovery import Recovery, recover
    from aslip.log.walk import read_walk

__all__ = [
    "JointRate",
    "Recorder",
    "Recording",
    "Recovery",
    "Replay",
    "Series",
    "read",
    "read_walk",
    "recover",
    "replay",
]

JointRate = Literal["policy", "physics"]
"""Rate at which joints are logged: every policy step, or every substep."""

__getattr__, __dir__ = attach(
    __name__,
    {
        "reader": ["Recording", "Series", "read"],
        "recorder": ["Recorder"],
        "recovery": ["Recovery", "recover"],
        "playback": ["Replay", "replay"],
        "walk": ["read_walk"],
    },
)
