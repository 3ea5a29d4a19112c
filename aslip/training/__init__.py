"""Training runs: folders, checkpoints, collectors, provenance, command lines."""
