"""Gait of a whole stride, and the stride of a gait as a guess for another command."""

import numpy as np

from aslip.rom.arc import twist_pose
from aslip.rom.assemble import POINTS, assemble, check_points, effort
from aslip.rom.certificate import Certificate
from aslip.rom.gait import Gait
from aslip.rom.slip import SlipParameters
from aslip.rom.stride import WholeStride, footholds, schedule


def gait_of_stride(
    solution: WholeStride, command: np.ndarray, certificate: Certificate, p: SlipParameters
) -> Gait:
    """Gait of a solved stride."""
    controls = np.split(solution.control, 4, axis=1)
    durations = 2 * [p.single_stance, solution.double_stance]
    return assemble(
        command=command,
        double_stance=solution.double_stance,
        state=solution.state,
        controls=controls,
        footholds=footholds(solution, command, p),
        cost=float(sum(effort(u, d) for u, d in zip(controls, durations, strict=True))),
        certificate=certificate,
        parameters=p,
    )


def stride_of_gait(gait: Gait, command: np.ndarray) -> WholeStride:
    """Stride of a gait, carried over to the path of another command.

    Body and footholds keep their places in the moving frame; the body's velocity changes by the
    difference of the commands.

    Raises:
        ShapeError: the gait's number of collocation points is not the optimiser's.
    """
    check_points(gait)
    to_frame = twist_pose(gait.command, gait.time).inverse()
    from_frame = twist_pose(command, gait.time)
    faster = np.array([command[0], command[1], 0.0])
    faster[: min(len(gait.command), 2)] -= gait.command[:2]
    state = [
        from_frame.transform(to_frame.transform(gait.body.position)),
        from_frame.rotate(to_frame.rotate(gait.body.velocity) + faster),
        gait.set_point,
        gait.set_point_velocity,
    ]
    _, mid_stance = schedule(gait.double_stance, gait.parameters)
    ground = np.stack([gait.feet.position[-1, 0], gait.feet.position[0, 1]])
    foothold = twist_pose(gait.command, np.array(mid_stance)).inverse().transform(ground)
    controls = [gait.control[POINTS * k : POINTS * (k + 1) + 1] for k in range(4)]
    return WholeStride(
        state=np.hstack(state).T,
        control=np.vstack(controls).T,
        double_stance=gait.double_stance,
        foothold=foothold[:, :2].T,
    )
