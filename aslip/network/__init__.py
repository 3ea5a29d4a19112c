"""Cassie's network protocol, the simulated robot behind it, and the runner of a controller."""
