"""Logs of rollouts: one self-contained MCAP file that viewers show and simulations replay.

    recorder = Recorder("walk.mcap", policy="aslip")        # last transform of a stack
    recording = read("walk.mcap")                           # arrays by topic and name
    check("walk.mcap"), recover("walk.mcap.part"), replay("walk.mcap")

The same from a shell: `python -m aslip.log info | check | recover | replay --verify`.
"""

from aslip.log.check import check
from aslip.log.reader import Recording, Series, read
from aslip.log.recorder import JointRate, Recorder
from aslip.log.recover import Recovery, recover
from aslip.log.replay import Replay, replay

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
