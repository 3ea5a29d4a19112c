from .controller import Controller as Controller
from .controller import ControllerState as ControllerState
from .path import Eight as Eight
from .path import PathFollower as PathFollower
