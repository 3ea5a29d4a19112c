from .device import check_device as check_device
from .simulations import CONSTRAINTS as CONSTRAINTS
from .simulations import CONTACTS as CONTACTS
from .simulations import WarpSimulations as WarpSimulations
