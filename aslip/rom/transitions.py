"""Ends of a stop and a start in a gait, and the motions of a solution."""

from collections.abc import Sequence

import numpy as np

from aslip.errors import ConfigurationError
from aslip.rom.assemble import POINTS, check_points
from aslip.rom.certificate import Certificate
from aslip.rom.gait import Gait
from aslip.rom.motion import Track
from aslip.rom.program import ModeSolution
from aslip.rom.slip import SlipParameters
from aslip.rom.standing import Transition


def ends_of_gait(gait: Gait) -> np.ndarray:
    """(26,) states at left touchdown and at right lift-off (10 + 10), left and right foot (3 + 3).

    Raises:
        ConfigurationError: the gait does not step in place.
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    if gait.command.any():
        raise ConfigurationError(
            f"stop and start belong to the gait in place, got that at {gait.command.tolist()}"
        )
    tracks = gait.body.position, gait.body.velocity, gait.set_point, gait.set_point_velocity
    state = np.hstack(tracks)
    return np.concatenate([state[POINTS], state[2 * POINTS], gait.feet.position[POINTS].ravel()])


def transitions_of(
    modes: Sequence[ModeSolution], certificate: Certificate, p: SlipParameters
) -> tuple[Transition, Transition]:
    """Stop and start from their two solved modes."""
    stop, start = (
        Transition(
            stride=mode.duration,
            time=np.linspace(0.0, mode.duration, mode.state.shape[1]),
            body=Track(mode.state[0:3].T, mode.state[3:6].T),
            feet=np.stack(mode.feet),
            set_point=mode.state[6:8].T,
            set_point_velocity=mode.state[8:10].T,
            control=mode.control.T,
            certificate=certificate,
            parameters=p,
        )
        for mode in modes
    )
    return stop, start
