"""Page in the browser to watch, push and stop a robot that another program moves."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping

import numpy as np

from aslip.library.footholds import yaw_rotation
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.live.pushes import PushControls
from aslip.show.live.readouts import ROBOT_LABEL, text_table
from aslip.show.live.scene import RobotScene
from aslip.show.live.server import guard, page_url, start_server, switch

_PANEL_WIDTH = 340


class RobotPage:
    """Page that shows a robot's configuration and a few lines of text.

    Unlike `LivePage` it knows neither policy nor reference, and simulates nothing.

    Args:
        host: name or address of this machine to listen on. With "0.0.0.0" other machines can see
            the page, push and stop, without authentication.
        port: port to listen on; 0 for any free one.

    Raises:
        ConfigurationError: the host is not this machine, or the port is taken or not allowed.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        title = f"{ROBOT_LABEL}, twin"
        self._server = start_server(host, port, title)
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label(title)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_WIDTH)
        self.stop = gui.add_checkbox("emergency stop", False)
        """Switch of the emergency stop."""
        self.pushes = PushControls(gui)
        """Sliders and button of pushes."""
        self._lines = gui.add_html("")
        self._clicks: queue.SimpleQueue[np.ndarray] = queue.SimpleQueue()
        self.pushes.button.on_click(lambda _: self._clicks.put(self.pushes.force()))
        guard(self._server, {**self.pushes.checks(), self.stop._impl.uuid: switch})
        self._scene = RobotScene(self._server, load_model())
        self._orientation = CASSIE.standing[CASSIE.indices.pelvis_orientation]

    @property
    def url(self) -> str:
        """Address of the page on this machine."""
        return page_url(self._server)

    def show(self, qpos: np.ndarray, lines: Mapping[str, str]) -> None:
        """Draw the robot and its lines of text.

        Args:
            qpos: (35,) generalised positions.
            lines: name of a line -> text.
        """
        self._orientation = qpos[CASSIE.indices.pelvis_orientation]
        with self._server.atomic():
            self._scene.update(qpos)
            self._lines.content = text_table([*lines.items()])

    def forces(self) -> Iterator[np.ndarray]:
        """Forces (3,) of the pushes since the last call, in order [N, world]."""
        while True:
            try:
                yield yaw_rotation(self._orientation) @ self._clicks.get_nowait()
            except queue.Empty:
                return

    def close(self) -> None:
        """Close the page."""
        self._server.stop()
