"""Logs of rollouts: one self-contained MCAP file that viewers show and simulations replay.

    recorder = Recorder("walk.mcap", policy="aslip")        # last transform of a stack
    recording = read("walk.mcap")                           # arrays by topic and name
    check("walk.mcap"), recover("walk.mcap.part"), replay("walk.mcap")

The same from a shell: `python -m aslip.log info | check | recover | replay --verify`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aslip.log.check import check
from aslip.log.reader import Recording, Series, read
from aslip.log.recover import Recovery, recover
from aslip.log.replay import Replay, replay
from aslip.settings import JointRate

if TYPE_CHECKING:
    from aslip.log.recorder import Recorder

__all__ = [
    "JointRate",
    "Recorder",
    "Recording",
    "Recovery",
    "Replay",
    "Series",
    "check",
    "read",
    "recover",
    "replay",
]


def __getattr__(name: str) -> Any:
    """Import the recorder, a TorchRL transform, on first use: reading a log needs no PyTorch."""
    if name != "Recorder":
        raise AttributeError(f"module 'aslip.log' has no attribute {name!r}; it has {__all__}")
    from aslip.log.recorder import Recorder

    return Recorder
