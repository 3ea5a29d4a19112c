from . import errors as errors
from .control import Controller as Controller
from .envs import GymEnv as GymEnv
from .envs import GymVectorEnv as GymVectorEnv
from .envs import RobotEnv as RobotEnv
from .envs import default_stack as default_stack
from .envs import make_env as make_env
from .library import GaitLibrary as GaitLibrary
from .library import Reference as Reference
from .policy import load_policy as load_policy
from .rom import Gait as Gait
from .rom import Motion as Motion

__version__: str
