"""Runner: a controller at one end of the robot's network protocol, with start-up and safe stop.

`supervisor` decides, `readings` interpret packets, `commands` ask the operator, `loop` keeps time,
`record` writes the log and replays it. None of them imports PyTorch or a simulator.
"""
