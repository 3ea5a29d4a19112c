from .drive import CommandedPD as CommandedPD
from .engine import ENGINES as ENGINES
from .engine import drake_engine as drake_engine
from .engine import mujoco_engine as mujoco_engine
from .lockstep import serve_lockstep as serve_lockstep
from .real_time import Load as Load
from .real_time import RealTimeServer as RealTimeServer
from .robot import TwinRobot as TwinRobot
