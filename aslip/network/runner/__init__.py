"""Runner of a controller over the robot's network protocol, with start-up and safe stop.

`supervisor` chooses the motor commands, `readings` converts packets, `commands` reads the
operator's requests, `loop` keeps time, and `record` writes and replays logs. None of them imports
PyTorch or a simulator.
"""
