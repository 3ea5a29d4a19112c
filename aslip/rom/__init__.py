"""Reduced-order models and their motions: actuated SLIP, linear inverted pendulum, recorded walks.

    gait = optimize_gait(1.0)          # 1 m/s, in a fraction of a second
    turn = optimize_gait([0.5, 0.2, 1.0])    # forward, sideways [m/s], yaw rate [rad/s]
    stop, start = optimize_transitions(optimize_gait([0.0, 0.0, 0.0]))
    gait.stride, gait.double_stance    # [s]
    gait.sample(np.linspace(0, 1, 24, endpoint=False)).body.position    # (24, 3) [m]

Sampling a motion needs NumPy and SciPy only; CasADi is imported when a gait is optimised. The
package imports neither the robot nor a learning library.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
