from .contact import Contact as Contact
from .plant import Mechanism as Mechanism
from .simulation import DrakeSimulation as DrakeSimulation
