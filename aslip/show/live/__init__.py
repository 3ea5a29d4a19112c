"""Page in the browser to watch and steer one robot in real time.

    page = LivePage(Walker(), {"aslip": "aslip", "mine": "runs/ppo_directions"})
    page.serve()  # until Ctrl-C

Needs viser: `pip install 'aslip[live]'`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aslip.imports import attach, extras

with extras():
    import viser as _viser  # noqa: F401

if TYPE_CHECKING:
    from aslip.show.live.page import LivePage
    from aslip.show.live.robot_page import RobotPage

__all__ = ["LivePage", "RobotPage"]

__getattr__, __dir__ = attach(__name__, {"page": ["LivePage"], "robot_page": ["RobotPage"]})
