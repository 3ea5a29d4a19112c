from .policy import export_policy as export_policy
