"""Benchmarks of the planner and of its models."""
