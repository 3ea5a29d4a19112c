"""Logs of rollouts: one self-contained MCAP file that viewers show and simulations replay.

    recorder = Recorder("walk.mcap", policy="straight")     # last transform of a stack
    recording = read("walk.mcap")                           # arrays by topic and name
    export(recording, "parquet")                            # tables for other programs
    recover("walk.mcap.part"), replay("walk.mcap")

From a shell: `python -m aslip.log info | check | export | recover | replay --verify`.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
