"""Gaits and libraries: solving, look-ups, demand on the motors."""
