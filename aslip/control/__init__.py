"""Controllers that turn sensor packets into motor targets, on a robot and in simulation.

`python -m aslip.network.runner` runs a controller over the robot's network protocol.
"""

from aslip.base.imports import attach

# the runner works without PyTorch, which `controller` imports
__getattr__, __dir__, __all__ = attach(__name__, __file__)
