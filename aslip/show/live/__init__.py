"""Page in the browser to watch and steer one robot in real time.

    page = LivePage(Walker(), {"aslip": "aslip", "mine": "runs/ppo_directions"})
    page.serve()  # until Ctrl-C

Needs viser: `pip install 'aslip[live]'`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

from aslip.errors import ConfigurationError

try:
    import viser as _viser  # noqa: F401
except ImportError as error:
    raise ConfigurationError(
        "the live page needs viser, which is not installed: pip install 'aslip[live]'"
    ) from error

if TYPE_CHECKING:
    from aslip.show.live.page import LivePage
    from aslip.show.live.robot_page import RobotPage

__all__ = ["LivePage", "RobotPage"]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"page": ["LivePage"], "robot_page": ["RobotPage"]}
)
