"""Assemble a gait from states, inputs and footholds at the collocation points of a stride."""

from collections.abc import Sequence

import numpy as np

from aslip.errors import ShapeError
from aslip.rom import collocation
from aslip.rom.certificate import Certificate
from aslip.rom.dynamics import leg_function
from aslip.rom.gait import Gait, swinging_feet
from aslip.rom.motion import Track
from aslip.rom.program import INTERVALS
from aslip.rom.slip import Mode, SlipParameters

MODES = (Mode.RIGHT, Mode.DOUBLE, Mode.LEFT, Mode.DOUBLE)
"""Contact modes of a stride."""
POINTS = 2 * INTERVALS
"""Collocation points per contact mode, without its last one, the first of the next mode."""


def collocation_times(double_stance: float, p: SlipParameters) -> np.ndarray:
    """Times (8 N + 1,) of a stride's collocation points [s], N intervals per mode."""
    half_period = p.single_stance + double_stance
    time = np.r_[
        np.linspace(0.0, p.single_stance, POINTS, endpoint=False),
        np.linspace(p.single_stance, half_period, POINTS, endpoint=False),
    ]
    return np.r_[time, time + half_period, 2 * half_period]


def assemble(
    *,
    command: np.ndarray,
    double_stance: float,
    state: np.ndarray,
    controls: Sequence[np.ndarray],
    footholds: np.ndarray,
    cost: float,
    certificate: Certificate,
    parameters: SlipParameters,
) -> Gait:
    """Gait of a solved stride.

    Args:
        command: (c,) command.
        double_stance: duration of each double stance [s].
        state: (10, 8 N + 1) states.
        controls: inputs (2, 2 N + 1) of the four modes [m/s^2].
        footholds: (2, 2, 3) start and end of the left and of the right swing [m].
        cost: integral of the squared inputs over the stride [m^2/s^3].
        certificate: certificate of the solution.
        parameters: model parameters.
    """
    p, time = parameters, collocation_times(double_stance, parameters)
    stride = float(time[-1])
    turn = command[2] * stride if len(command) == 3 else 0.0
    # where modes meet, the input is that of the mode that begins
    control = np.hstack([*(u[:, :-1] for u in controls), controls[0][:, :1]])
    return Gait(
        command=command,
        stride=stride,
        time=time,
        mode=np.r_[np.repeat([int(m) for m in MODES], POINTS), int(MODES[0])],
        body=Track(state[0:3].T, state[3:6].T),
        feet=swinging_feet(time, stride, footholds, p, turn=turn),
        leg_force=_leg_force(state, footholds, p),
        set_point=state[6:8].T,
        set_point_velocity=state[8:10].T,
        control=control.T,
        cost=cost,
        certificate=certificate,
        parameters=p,
    )


def cost_of(control: np.ndarray, duration: float) -> np.floating:
    """Integral of u_l^2 + u_r^2 over a mode [m^2/s^3]."""
    return duration / INTERVALS * np.sum(control**2 @ collocation.weights(INTERVALS))


def check_points(gait: Gait) -> None:
    """Check that a gait has the optimiser's number of collocation points.

    Raises:
        ShapeError: the number differs.
    """
    if len(gait.time) != 4 * POINTS + 1:
        raise ShapeError(f"a guess needs {4 * POINTS + 1} collocation points, got {len(gait.time)}")


def _leg_force(state: np.ndarray, footholds: np.ndarray, p: SlipParameters) -> np.ndarray:
    """Leg forces (8 N + 1, 2) [N], 0 in swing."""
    point = np.arange(state.shape[1])
    # the left foot stands where its swing ends, the right one only once it has landed
    left = np.repeat(footholds[0, 1][:, None], len(point), axis=1)
    landed = point >= 3 * POINTS
    right = np.where(landed, footholds[1, 1][:, None], footholds[1, 0][:, None])
    force = np.array(leg_function(p)(state, left, right)[0]).T
    standing = [[*MODES, MODES[0]][k // POINTS].stance for k in point]
    return np.where(standing, force, 0.0)
