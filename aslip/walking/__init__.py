"""Walks of a policy: recorded, evaluated, measured."""
