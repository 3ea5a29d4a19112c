"""Write the skeleton of Cassie's MJCF: `python -m aslip.robot`, after a change of the model."""

from __future__ import annotations

from aslip.robot.cassie import CASSIE
from aslip.robot.compile import compile_skeleton
from aslip.robot.skeleton import write_skeleton

if __name__ == "__main__":
    path = CASSIE.mjcf.with_suffix(".json")
    write_skeleton(compile_skeleton(CASSIE.mjcf), CASSIE.mjcf, path)
    print(path)
