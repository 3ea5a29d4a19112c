from .network import export_network as export_network
from .policy import compare as compare
from .policy import export_policy as export_policy
from .policy import write_pipeline as write_pipeline
