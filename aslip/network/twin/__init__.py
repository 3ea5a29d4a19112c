"""Twin of a robot: the simulation behind the robot's network protocol.

`python -m aslip.network.twin` starts a twin that waits for a client.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
