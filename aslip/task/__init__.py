"""Cassie in dm_control: questions to the physics, and the rules of a walking task."""

from aslip.task.physics import CassiePhysics
from aslip.task.walk import FALL_HEIGHT, Walk, walk_environment

__all__ = ["FALL_HEIGHT", "CassiePhysics", "Walk", "walk_environment"]
