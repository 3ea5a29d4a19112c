from .estimator import StateEstimator as StateEstimator
from .filter import Belief as Belief
from .legs import LegKinematics as LegKinematics
from .noise import FilterNoise as FilterNoise
from .packets import FAULTS as FAULTS
from .state import Estimate as Estimate
from .state import Tracking as Tracking
from .state import tracking_size as tracking_size
