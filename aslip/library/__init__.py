"""Gait libraries: motions over a grid of commands, with joint angles of the robot.

    walks = optimize_gaits((0.0, 0.5, 1.0), parameters=SlipParameters(mass=33.3))
    library = GaitLibrary.from_motions(walks)      # inverse kinematics
    library.save("gaits.npz")
    library = GaitLibrary.load("gaits.npz")        # without a path, the shipped one
    library.lookup(phase, command).motor_position

A library is made of motions of any reduced-order model, see `aslip.rom.Motion`. Looking motions up
imports none of CasADi, Pinocchio and MuJoCo.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
