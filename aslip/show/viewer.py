"""MuJoCo's viewer, in real time."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator

import mujoco
import mujoco.viewer
import numpy as np

from aslip.errors import RenderingError
from aslip.library.footholds import yaw_rotation
from aslip.robot import CASSIE
from aslip.show.film import Frame
from aslip.show.model_place import BESIDE_STEPS, RomPlace
from aslip.show.pacing import Pacer
from aslip.show.render import add_ghost


@contextlib.contextmanager
def open_viewer(
    model: mujoco.MjModel, *, rom: RomPlace = "beside"
) -> Iterator[Callable[[Frame], None]]:
    """Open a window; yield a function that shows a frame for the duration of a policy step.

    The function raises KeyboardInterrupt once the window is closed.

    Args:
        model: the robot with its visible geoms, see `aslip.show.film.Look.model`.
        rom: place of the reduced-order model.

    Raises:
        RenderingError: there is no display.
    """
    # without a display MuJoCo fails in a thread of its own, and waits
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise RenderingError("MuJoCo's viewer needs a display; without one use --video")
    data, orientation = mujoco.MjData(model), CASSIE.indices.pelvis_orientation
    try:
        window = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except Exception as error:  # each platform has its own
        raise RenderingError(
            f"MuJoCo's viewer cannot open a window ({error}); without a display use --video"
        ) from error
    with window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = model.body(CASSIE.pelvis).id
        pacer = Pacer(CASSIE.policy_period)

        def show(frame: Frame) -> None:
            if not window.is_running():
                raise KeyboardInterrupt
            with window.lock():
                data.qpos[:] = frame.qpos
                mujoco.mj_forward(model, data)
                if rom != "hidden" and window.user_scn is not None:
                    window.user_scn.ngeom = 0
                    beside = yaw_rotation(frame.qpos[orientation]) @ BESIDE_STEPS
                    offset = beside if rom == "beside" else np.zeros(3)
                    add_ghost(window.user_scn, frame.ghost.moved(offset))
            window.sync()
            pacer.wait()

        yield show
