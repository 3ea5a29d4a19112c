from .cassie import CASSIE as CASSIE
from .names import SIDES as SIDES
from .names import Side as Side
from .names import mirror_name as mirror_name
from .noise import NoiseLevel as NoiseLevel
from .robot import STANDARD_GRAVITY as STANDARD_GRAVITY
from .robot import Indices as Indices
from .robot import Robot as Robot
