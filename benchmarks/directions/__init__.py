"""Walks in all directions: tracking, changes of the command, stops, a path."""
