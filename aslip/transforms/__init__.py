"""Everything that varies between experiments, as TorchRL transforms.

Each transform reads and writes documented keys of the tensordict. State of an episode is in the
tensordict, not in the transform, so partial resets, worker processes and replay just work.
Transforms that draw random numbers own a generator, which `env.set_seed` seeds.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
