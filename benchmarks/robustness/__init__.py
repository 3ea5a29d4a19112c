"""Pushes, changed robots and floors, other physics engines."""
