"""Page in the browser to watch and steer one robot in real time.

    page = LivePage(Walker(), {"directions": "directions", "mine": "runs/ppo_directions"})
    page.serve()  # until Ctrl-C

Needs viser: `pip install 'aslip[live]'`.
"""

from aslip.base.imports import attach, extras

with extras():
    import viser as _viser  # noqa: F401

__getattr__, __dir__, __all__ = attach(__name__, __file__)
