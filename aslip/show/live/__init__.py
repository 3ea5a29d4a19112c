"""Page in the browser to watch and steer one robot in real time.

    page = LivePage(Walker(), {"aslip": "aslip", "mine": "runs/ppo_aslip"})
    page.serve()  # until Ctrl-C

Needs viser: `pip install 'aslip[live]'`.
"""

from aslip.errors import ConfigurationError

try:
    import viser as _viser  # noqa: F401
except ImportError as error:
    raise ConfigurationError(
        "the live page needs viser, which is not installed: pip install 'aslip[live]'"
    ) from error

from aslip.show.live.page import LivePage
from aslip.show.live.robot_page import RobotPage

__all__ = ["LivePage", "RobotPage"]
